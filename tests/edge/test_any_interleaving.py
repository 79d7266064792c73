"""Any interleaving of frames, pages, deaths, routes, ends, and robots that go and come back."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Callable

from edge_samples import STREAM, frame, profile, routes
from hypothesis import given, settings
from hypothesis import strategies as st

from common.presence import RobotSeen
from common.wire import EndOfStream
from services.edge_worker import state as slam
from services.edge_worker.checkpoint import Checkpoint
from services.edge_worker.instance import DEADLY
from services.edge_worker.instructions import (
    Acknowledge,
    Claim,
    Feed,
    Fetch,
    Finish,
    GiveUp,
    Instruction,
    Keep,
    Listen,
    Open,
    Release,
)
from services.edge_worker.phase import Phase
from services.edge_worker.state import EdgeState

Frames = list[int]
"""numbers of the frames that a kernel has taken"""
Work = Callable[[], slam.Event | None]


class World:
    """Robots with spools, workers that answer in order, checkpoints, and a network that loses, doubles and reorders."""

    def __init__(self, seed: int, robots: int, frames: int, durable: bool) -> None:
        self.random = random.Random(seed)
        self.robots = [f"r{k}" for k in range(robots)]
        self.frames, self.sent = frames, dict.fromkeys(self.robots, 0)
        self.durable = durable
        self.oldest = dict.fromkeys(self.robots, 0)
        """first frame still in the spool"""
        self.there = dict.fromkeys(self.robots, True)
        self.now = 0.0
        self.state = EdgeState("e1", 2, window=8, lease_s=20.0, keep_frames=5, keep_s=30.0)
        self.pending: list[slam.Event] = []
        self.queues: dict[int, list[Work]] = defaultdict(list)
        self.kernels: dict[tuple[str, int], Frames] = {}
        self.refined: set[tuple[str, int]] = set()
        self.kept: dict[str, tuple[Checkpoint, Frames]] = {}
        self.deadly: dict[str, set[int]] = defaultdict(set)
        """frames that killed twice, also under instances that were released since: checkpoints go on without them"""
        self.count = 1
        self.route(dict.fromkeys(self.robots, "e1"))
        for robot in self.robots:
            self.give(RobotSeen(robot, True, 0.0))

    def route(self, slam_edges: dict[str, str]) -> None:
        self.give(slam.Routed(routes(self.count, slam_edges, epochs=dict.fromkeys(slam_edges, self.count))))
        self.count += 1

    def give(self, event: slam.Event) -> None:
        for step in self.state.handle(event):
            self.carry_out(step)
        self.state.validate()
        for robot, instance in self.state.instances.items():
            self.deadly[robot] |= {seq for seq, deaths in instance.deaths.items() if deaths >= DEADLY}

    def carry_out(self, step: Instruction | Claim) -> None:
        match step:
            case Open(robot, _, worker):
                self.queues[worker].append(lambda: self.open(step))
            case Feed(robot) | Keep(robot) | Finish(robot):
                work: dict[type[Instruction], Callable[[], slam.Event | None]] = {
                    Feed: lambda: self.take(step),
                    Keep: lambda: self.keep(step),
                    Finish: lambda: self.finish(step),
                }
                self.queues[self.state.instances[robot].worker].append(work[type(step)])
            case Fetch(robot, life, _, start):
                self.pending.append(self.page(robot, life, start))
            case Acknowledge(robot):
                self.oldest[robot] = max(self.oldest[robot], self.state.instances[robot].keeping.durable + 1)
            case Release() | Listen() | Claim() | GiveUp():
                pass

    def open(self, step: Open) -> slam.Event:
        found = self.kept.get(step.robot)
        if found is None or (not self.durable and self.random.random() < 0.2):
            self.kernels[step.robot, step.life] = []
            return slam.Opened(step.robot, step.life)
        self.kernels[step.robot, step.life] = list(found[1])
        return slam.Opened(step.robot, step.life, found[0], self.durable)

    def take(self, step: Feed) -> slam.Event:
        assert (step.robot, step.life) not in self.refined, "a refined kernel goes on"
        self.kernels[step.robot, step.life].append(step.frame.seq)
        return slam.FrameDone(step.robot, step.life, step.frame.seq, failed=self.random.random() < 0.1)

    def keep(self, step: Keep) -> slam.Event | None:
        if self.random.random() < 0.1:
            return None  # the disk is full
        before = self.kept.get(step.robot)
        if before is None or before[0].seq <= step.checkpoint.seq:
            self.kept[step.robot] = step.checkpoint, list(self.kernels[step.robot, step.life])
        return slam.KeptDurably(step.robot, step.life, step.checkpoint.seq) if self.durable else None

    def finish(self, step: Finish) -> slam.Event:
        self.refined.add((step.robot, step.life))
        return slam.InstanceFinished(step.robot, step.life)

    def page(self, robot: str, life: int, start: int) -> slam.Event:
        if not self.there[robot] or self.random.random() < 0.2:
            return slam.FetchFailed(robot, life)
        start = max(start, self.oldest[robot])
        end = min(start + self.random.randint(1, 6), self.sent[robot])
        frames = tuple(frame(seq, robot) for seq in range(start, end))
        return slam.PageCame(robot, life, STREAM, frames, self.oldest[robot], end if end < self.sent[robot] else None)

    def anything(self) -> None:
        kind = self.random.random()
        robot = self.random.choice(self.robots)
        if kind < 0.4 and self.sent[robot] < self.frames:
            for _ in range(self.random.choice((0, 1, 1, 2)) if self.there[robot] else 0):
                self.pending.append(slam.FrameCame(frame(self.sent[robot], robot)))
            self.sent[robot] += 1
        elif kind < 0.6 and self.pending:
            self.give(self.pending.pop(self.random.randrange(len(self.pending))))
        elif kind < 0.86:
            self.work(self.random.randrange(2))
        elif kind < 0.88:
            self.die(self.random.randrange(2))
        elif kind < 0.9:
            self.route({each: self.random.choice(("e1", "e1", "e2")) for each in self.robots})
        elif kind < 0.93:
            self.go_or_come(robot)
        elif kind < 0.94:
            self.end(robot, self.sent[robot] - 1)
        else:
            self.tick()

    def tick(self) -> None:
        self.now += self.random.choice((0.5, 0.5, 11.0))
        self.give(slam.Tick(self.now))

    def go_or_come(self, robot: str) -> None:
        self.there[robot] = not self.there[robot]
        told: list[slam.Event] = [RobotSeen(robot, self.there[robot], self.now)]
        told += [slam.Profiled(profile(robot))] if self.there[robot] else []
        for event in self.random.sample(told, len(told)):
            self.give(event)

    def end(self, robot: str, last_seq: int) -> None:
        self.give(slam.Ended(EndOfStream(robot=robot, stream=STREAM, last_seq=last_seq)))

    def work(self, worker: int) -> None:
        if self.queues[worker]:
            event = self.queues[worker].pop(0)()
            if event is not None:
                self.give(event)

    def die(self, worker: int) -> None:
        done = [work() for work in self.queues.pop(worker, [])[: self.random.randrange(3)]]
        self.give(slam.WorkerDied(worker))
        self.pending += [event for event in done if event is not None]  # answers of the dead may still be on their way

    def settle(self) -> None:
        """Everybody is there in the end, everything is sent and delivered."""
        self.route(dict.fromkeys(self.robots, "e1"))
        for robot in self.robots:
            if not self.there[robot]:
                self.go_or_come(robot)
            self.sent[robot] = self.frames
            self.end(robot, self.frames - 1)
        for _ in range(60 * self.frames + 200):
            for worker in range(2):
                self.work(worker)
            if self.pending:
                self.give(self.pending.pop())
            else:
                self.tick()


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    steps=st.integers(0, 300),
    robots=st.integers(1, 3),
    frames=st.integers(0, 30),
    durable=st.booleans(),
)
def test_a_final_map_has_every_frame_once_in_order_whatever_happened_before(
    seed: int, steps: int, robots: int, frames: int, durable: bool
) -> None:
    world = World(seed, robots, frames, durable)
    for _ in range(steps):
        world.anything()
    world.settle()
    for seqs in world.kernels.values():
        assert seqs == sorted(set(seqs))
    for robot, instance in world.state.instances.items():
        assert instance.phase is Phase.FINAL
        taken = world.kernels[robot, instance.life]
        assert set(range(frames)) - set(taken) <= world.deadly[robot]
        assert instance.backlog.gaps == 0
