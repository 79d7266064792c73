"""All instances of an edge, by events; and any interleaving of frames, pages, deaths and routes."""

from __future__ import annotations

import random
from collections import defaultdict

from edge_samples import OTHER, STREAM, frame, profile, routes
from hypothesis import given, settings
from hypothesis import strategies as st

from common.wire import EndOfStream
from services.edge_worker import state as slam
from services.edge_worker.instance import Phase
from services.edge_worker.instructions import Claim, Feed, Fetch, Finish, Instruction, Listen, Open, Release
from services.edge_worker.state import EdgeState


def edge(workers: int = 2) -> EdgeState:
    return EdgeState("e1", workers, window=16)


def taken(state: EdgeState, *robots: str, n: int = 1) -> list[Instruction | Claim]:
    return state.handle(slam.Routed(routes(n, dict.fromkeys(robots, "e1"))))


def test_robots_are_spread_over_the_workers() -> None:
    steps = taken(edge(), "r1", "r2", "r3")
    assert [step.worker for step in steps if isinstance(step, Open)] == [0, 1, 0]
    assert Claim() in steps


def test_a_stale_table_changes_nothing() -> None:
    state = edge()
    taken(state, "r1", n=5)
    assert state.handle(slam.Routed(routes(4, {"r1": "e2"}))) == []
    assert state.counters["stale routing tables"] == 1


def test_a_robot_routed_elsewhere_is_released() -> None:
    state = edge()
    taken(state, "r1")
    steps = state.handle(slam.Routed(routes(2, {"r1": "e2"})))
    assert steps == [Release("r1", 1, 0), Claim()]
    assert not state.instances


def test_a_robot_that_the_table_does_not_name_stays() -> None:
    state = edge()
    taken(state, "r1")
    state.handle(slam.Routed(routes(2, {})))
    assert "r1" in state.instances


def test_answers_of_a_released_instance_do_not_reach_the_next_one() -> None:
    state = edge()
    taken(state, "r1")
    state.handle(slam.Routed(routes(2, {"r1": "e2"})))
    steps = taken(state, "r1", n=3)
    assert [step.life for step in steps if isinstance(step, Open)] == [2]
    assert state.handle(slam.Opened("r1", 1)) == []
    assert state.instances["r1"].phase is Phase.OPENING


def test_an_edge_started_again_counts_lives_from_elsewhere() -> None:
    again = EdgeState("e1", 1, window=16, first_life=700)
    assert [step.life for step in taken(again, "r1") if isinstance(step, Open)] == [701]


def test_an_end_told_before_the_robot_was_routed_here_counts() -> None:
    state = edge()
    state.handle(slam.Ended(EndOfStream(robot="r1", stream=STREAM, last_seq=-1)))
    taken(state, "r1")
    state.handle(slam.Opened("r1", 1))
    assert state.instances["r1"].phase is Phase.FINISHING


def test_an_end_told_before_its_streams_profile_counts() -> None:
    state = edge()
    state.handle(slam.Profiled(profile()))
    taken(state, "r1")
    state.handle(slam.Ended(EndOfStream(robot="r1", stream=OTHER, last_seq=-1)))
    assert state.instances["r1"].last_seq is None
    state.handle(slam.Profiled(profile(stream=OTHER)))
    assert state.instances["r1"].last_seq == -1


def test_only_the_frame_that_was_fed_first_is_blamed_for_a_workers_death() -> None:
    state = edge(workers=1)
    taken(state, "r1", "r2")
    for robot in ("r1", "r2"):
        state.handle(slam.Opened(robot, 1))
    state.handle(slam.FrameCame(frame(0, "r2")))
    state.handle(slam.FrameCame(frame(0, "r1")))
    state.handle(slam.WorkerDied(0))
    assert {robot: dict(each.deaths) for robot, each in state.instances.items()} == {"r1": {}, "r2": {0: 1}}


def test_frames_of_robots_not_run_here_are_counted() -> None:
    state = edge()
    assert state.handle(slam.FrameCame(frame(0))) == []
    assert state.counters["frames of robots not run here"] == 1


class World:
    """Robots with spools, workers that answer in order, and a network that loses, doubles and reorders."""

    def __init__(self, seed: int, robots: int, frames: int) -> None:
        self.random = random.Random(seed)
        self.robots = [f"r{k}" for k in range(robots)]
        self.frames, self.sent = frames, dict.fromkeys(self.robots, 0)
        self.state = EdgeState("e1", 2, window=8)
        self.pending: list[slam.Event] = []
        self.queues: dict[int, list[slam.Event]] = defaultdict(list)
        self.fed: dict[tuple[str, int], list[int]] = defaultdict(list)
        self.count = 1
        self.route(dict.fromkeys(self.robots, "e1"))

    def route(self, slam_edges: dict[str, str]) -> None:
        self.give(slam.Routed(routes(self.count, slam_edges, epochs=dict.fromkeys(slam_edges, self.count))))
        self.count += 1

    def give(self, event: slam.Event) -> None:
        for step in self.state.handle(event):
            self.carry_out(step)
        self.state.validate()

    def carry_out(self, step: Instruction | Claim) -> None:
        match step:
            case Open(robot, life, worker):
                self.queues[worker].append(slam.Opened(robot, life))
            case Feed(robot, life, sample):
                self.fed[robot, life].append(sample.seq)
                done = slam.FrameDone(robot, life, sample.seq, failed=self.random.random() < 0.1)
                self.queues[self.state.instances[robot].worker].append(done)
            case Finish(robot, life):
                self.queues[self.state.instances[robot].worker].append(slam.InstanceFinished(robot, life))
            case Fetch(robot, life, _, start):
                self.pending.append(self.page(robot, life, start))
            case Release() | Listen() | Claim():
                pass

    def page(self, robot: str, life: int, start: int) -> slam.Event:
        if self.random.random() < 0.2:
            return slam.FetchFailed(robot, life)
        end = min(start + self.random.randint(1, 6), self.sent[robot])
        frames = tuple(frame(seq, robot) for seq in range(start, end))
        return slam.PageCame(robot, life, STREAM, frames, 0, end if end < self.sent[robot] else None)

    def anything(self) -> None:
        kind = self.random.random()
        robot = self.random.choice(self.robots)
        if kind < 0.4 and self.sent[robot] < self.frames:
            for _ in range(self.random.choice((0, 1, 1, 2))):
                self.pending.append(slam.FrameCame(frame(self.sent[robot], robot)))
            self.sent[robot] += 1
        elif kind < 0.6 and self.pending:
            self.give(self.pending.pop(self.random.randrange(len(self.pending))))
        elif kind < 0.9:
            self.work(self.random.randrange(2))
        elif kind < 0.92:
            self.die(self.random.randrange(2))
        elif kind < 0.94:
            self.route({each: self.random.choice(("e1", "e1", "e2")) for each in self.robots})
        else:
            self.give(slam.Tick())

    def work(self, worker: int) -> None:
        if self.queues[worker]:
            self.give(self.queues[worker].pop(0))

    def die(self, worker: int) -> None:
        late = self.queues.pop(worker, [])
        self.give(slam.WorkerDied(worker))
        self.pending += late  # answers of the dead may still be on their way to the state

    def settle(self) -> None:
        """Everything is sent and delivered in the end."""
        self.route(dict.fromkeys(self.robots, "e1"))
        for robot in self.robots:
            self.sent[robot] = self.frames
            self.give(slam.Ended(EndOfStream(robot=robot, stream=STREAM, last_seq=self.frames - 1)))
        for _ in range(60 * self.frames + 200):
            for worker in range(2):
                self.work(worker)
            if self.pending:
                self.give(self.pending.pop())
            else:
                self.give(slam.Tick())


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.integers(0, 300), robots=st.integers(1, 3), frames=st.integers(0, 30))
def test_every_frame_is_fed_once_in_order_in_each_life_and_all_becomes_final(
    seed: int, steps: int, robots: int, frames: int
) -> None:
    world = World(seed, robots, frames)
    for _ in range(steps):
        world.anything()
    world.settle()
    for seqs in world.fed.values():
        assert seqs == sorted(set(seqs))
    for robot, instance in world.state.instances.items():
        assert instance.phase is Phase.FINAL
        aside = {seq for seq, deaths in instance.deaths.items() if deaths >= 2}
        assert world.fed[robot, instance.life] == [seq for seq in range(frames) if seq not in aside]
        assert instance.gaps == 0
