"""What an edge worker decides about SLAM: which robots it runs, in which worker, and what becomes of their frames.

Events in, instructions out; no asyncio, no clock, no network. What happens within one robot's instance is in
instance.py; which maps are fused here is in fusing.py.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from common.wire import Claims, EndOfStream, Frame, RobotProfile, Routes
from services.edge_worker.instance import Instance, Instruction, Instructions, Phase


@dataclass(frozen=True)
class Routed:
    """A routing table came."""

    routes: Routes


@dataclass(frozen=True)
class Opened:
    robot: str
    life: int


@dataclass(frozen=True)
class FrameCame:
    frame: Frame


@dataclass(frozen=True)
class PageCame:
    """Frames out of a robot's spool; `more`: the spool has further ones."""

    robot: str
    life: int
    frames: tuple[Frame, ...]
    oldest: int
    more: bool


@dataclass(frozen=True)
class FetchFailed:
    robot: str
    life: int


@dataclass(frozen=True)
class FrameDone:
    robot: str
    life: int
    seq: int
    failed: bool = False


@dataclass(frozen=True)
class InstanceFinished:
    robot: str
    life: int


@dataclass(frozen=True)
class Ended:
    end: EndOfStream


@dataclass(frozen=True)
class Profiled:
    profile: RobotProfile


@dataclass(frozen=True)
class WorkerDied:
    """The worker of this number is gone; another has taken its place under the same number."""

    worker: int


@dataclass(frozen=True)
class Tick:
    """About once a second."""


Event = (
    Routed
    | Opened
    | FrameCame
    | PageCame
    | FetchFailed
    | FrameDone
    | InstanceFinished
    | Ended
    | Profiled
    | WorkerDied
    | Tick
)


@dataclass(frozen=True)
class Listen(Instruction):
    """Subscribe to the robot's frames."""


@dataclass(frozen=True)
class Release(Instruction):
    """Stop listening to the robot and forget its instance."""

    worker: int


@dataclass(frozen=True)
class Claim(Instruction):
    """Publish which robots run here."""


@dataclass
class EdgeState:
    """All instances of one edge."""

    edge: str
    workers: int
    window: int
    epoch: tuple[int, int] = (0, 0)
    """of the latest routing table"""
    instances: dict[str, Instance] = field(default_factory=dict)
    ends: dict[str, EndOfStream] = field(default_factory=dict)
    profiles: dict[str, RobotProfile] = field(default_factory=dict)
    counters: Counter[str] = field(default_factory=Counter)

    def handle(self, event: Event) -> Instructions:
        """Take one event. What concerns robots that do not run here, or an earlier life, changes nothing."""
        match event:
            case Routed(routes):
                return self._routed(routes)
            case FrameCame(frame):
                instance = self.instances.get(frame.robot)
                if instance is None:
                    self.counters["frames of robots not run here"] += 1
                    return []
                return instance.frame_came(frame)
            case Ended(end):
                self.ends[end.robot] = end
                instance = self.instances.get(end.robot)
                return instance.stream_ended(end.stream, end.last_seq) if instance else []
            case Profiled(profile):
                self.profiles[profile.robot] = profile
                instance = self.instances.get(profile.robot)
                return instance.stream_changed(profile.stream) if instance else []
            case WorkerDied(worker):
                self.counters["worker deaths"] += 1
                hurt = [each for each in self.instances.values() if each.worker == worker]
                return [step for each in hurt for step in each.worker_died(worker)]
            case Tick():
                return [step for each in self.instances.values() for step in each.tick()]
            case _:
                return self._answered(event)

    def claims(self) -> Claims:
        return Claims(edge=self.edge, claims={name: each.epoch for name, each in self.instances.items()})

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        for robot, instance in self.instances.items():
            assert instance.robot == robot
            assert 0 <= instance.worker < self.workers
            instance.validate()

    def _answered(self, event: Opened | PageCame | FetchFailed | FrameDone | InstanceFinished) -> Instructions:
        instance = self.instances.get(event.robot)
        if instance is None or instance.life != event.life:
            return []
        match event:
            case Opened():
                return instance.opened()
            case PageCame(_, _, frames, oldest, more):
                steps = [step for frame in frames for step in instance.frame_came(frame)]
                return [*steps, *instance.page_came(oldest, more)]
            case FetchFailed():
                return instance.fetch_failed()
            case FrameDone(_, _, seq, failed):
                return instance.frame_done(seq, failed)
            case InstanceFinished():
                return instance.finished()

    def _routed(self, routes: Routes) -> Instructions:
        if routes.epoch < self.epoch:
            self.counters["stale routing tables"] += 1
            return []
        self.epoch = routes.epoch
        mine = {robot: route for robot, route in routes.routes.items() if route.slam_edge == self.edge}
        steps: Instructions = []
        for robot in sorted(set(self.instances) - set(mine)):
            gone = self.instances.pop(robot)
            steps.append(Release(robot, gone.life, gone.worker))
        for robot in sorted(set(mine) - set(self.instances)):
            steps += self._take(robot, mine[robot].epoch)
        for robot, route in mine.items():
            self.instances[robot].epoch = route.epoch
        return [*steps, Claim("", 0)]

    def _take(self, robot: str, epoch: tuple[int, int]) -> Instructions:
        load = Counter(each.worker for each in self.instances.values() if each.phase is not Phase.FINAL)
        worker = min(range(self.workers), key=lambda number: (load[number], number))
        instance = self.instances[robot] = Instance(robot, epoch, worker, self.window)
        if robot in self.profiles:
            instance.stream = self.profiles[robot].stream
        steps: Instructions = [Listen(robot, 0), *instance.open()]
        if robot in self.ends:
            steps += instance.stream_ended(self.ends[robot].stream, self.ends[robot].last_seq)
        return steps
