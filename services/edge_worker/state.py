"""What an edge worker decides about SLAM: which robots it runs, in which worker, and what becomes of their frames.

Events in, instructions out; no asyncio, no clock, no network. What happens within one robot's instance is in
instance.py; which maps are fused here is in fusing.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

from common.presence import Linked, Presence, RobotSeen, RouterLink, seen
from common.wire import Claims, EndOfStream, Epoch, Frame, RobotProfile, Routes
from services.edge_worker.checkpoint import Checkpoint, Keeping
from services.edge_worker.instance import Instance
from services.edge_worker.instructions import Claim, Instructions, Listen, Release
from services.edge_worker.phase import Phase


@dataclass(frozen=True)
class Routed:
    """A routing table came."""

    routes: Routes


@dataclass(frozen=True)
class Opened:
    robot: str
    life: int
    restored: Checkpoint | None = None
    durable: bool = False
    """the checkpoint outlives this edge"""


@dataclass(frozen=True)
class KeptDurably:
    """A checkpoint lies where it outlives this edge."""

    robot: str
    life: int
    seq: int


@dataclass(frozen=True)
class FrameCame:
    frame: Frame


@dataclass(frozen=True)
class PageCame:
    """Frames out of a robot's spool, which has none older than `oldest` and goes on at `following`."""

    robot: str
    life: int
    stream: str
    frames: tuple[Frame, ...]
    oldest: int
    following: int | None


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

    now: float


Event = (
    Routed
    | RobotSeen
    | Linked
    | Opened
    | KeptDurably
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


@dataclass
class EdgeState:
    """All instances of one edge."""

    edge: str
    workers: int
    window: int
    first_life: int = 0
    """lives count from here: other processes of this edge's name counted from elsewhere"""
    lease_s: float = 60.0
    """for which a robot that is gone is waited for"""
    keep_frames: int = 1000
    keep_s: float = 60.0
    """a kernel is kept every so many frames, or seconds"""
    epoch: Epoch = (0, 0)
    """of the latest routing table"""
    instances: dict[str, Instance] = field(default_factory=dict)
    ends: dict[str, EndOfStream] = field(default_factory=dict)
    profiles: dict[str, RobotProfile] = field(default_factory=dict)
    counters: Counter[str] = field(default_factory=Counter)
    lives: dict[str, int] = field(default_factory=dict)
    """robot → last life of an instance that was released"""
    turns: Iterator[int] = field(default_factory=count)
    robots: dict[str, Presence] = field(default_factory=dict)
    link: RouterLink = field(default_factory=RouterLink)

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
                return self._profiled(profile)
            case WorkerDied(worker):
                return self._worker_died(worker)
            case RobotSeen(robot, alive, now):
                return self._robot_seen(robot, alive, now)
            case Linked(up, now):
                self.link.changed(up, now)
                return []
            case Tick(now):
                return [step for each in self.instances.values() for step in self._tick(each, now)]
            case _:
                return self._answered(event)

    def counts(self) -> dict[str, int]:
        """What was dropped or refused since the start, also of robots that have been released."""
        counts = self.counters.copy()
        for each in self.instances.values():
            counts.update(_dropped(each))
        return dict(counts)

    def claims(self) -> Claims:
        claims = {name: each.epoch for name, each in self.instances.items()}
        return Claims(edge=self.edge, claims=claims, epoch=self.epoch)

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        for robot, instance in self.instances.items():
            assert instance.robot == robot
            assert 0 <= instance.worker < self.workers
            instance.validate()

    def _answered(
        self, event: Opened | KeptDurably | PageCame | FetchFailed | FrameDone | InstanceFinished
    ) -> Instructions:
        instance = self.instances.get(event.robot)
        if instance is None or instance.life != event.life:
            return []
        match event:
            case Opened(_, _, restored, durable):
                return instance.opened(restored, durable)
            case KeptDurably(_, _, seq):
                return instance.kept_durably(seq)
            case PageCame(_, _, stream, frames, oldest, following):
                return instance.page_came(stream, frames, oldest, following)
            case FetchFailed():
                return instance.fetch_failed()
            case FrameDone(_, _, seq, failed):
                return instance.frame_done(seq, failed)
            case InstanceFinished():
                return instance.finished()

    def _robot_seen(self, robot: str, alive: bool, now: float) -> Instructions:
        seen(self.robots, robot, alive, now)
        instance = self.instances.get(robot)
        if instance is None or not alive:
            return []
        return [*instance.came_back(), *self._end_known(instance)]

    def _tick(self, instance: Instance, now: float) -> Instructions:
        presence = self.robots.setdefault(instance.robot, Presence(False, now))
        if instance.stirred and not presence.alive:
            presence.since = now  # there is still something of it to be done
        expired = self.link.missed_for(presence, now) > self.lease_s
        return [*instance.tick(now), *(instance.give_up() if expired else [])]

    def _profiled(self, profile: RobotProfile) -> Instructions:
        self.profiles[profile.robot] = profile
        instance = self.instances.get(profile.robot)
        if instance is None:
            return []
        return [*instance.stream_changed(profile.stream), *self._end_known(instance)]

    def _worker_died(self, worker: int) -> Instructions:
        """All instances of the worker start again; the first of what they had handed over unanswered is to blame."""
        self.counters["worker deaths"] += 1
        hurt = [each for each in self.instances.values() if each.worker == worker]
        turns = {each.robot: turn for each in hurt if (turn := each.turn) is not None}
        guilty = min(turns, key=lambda robot: turns[robot], default=None)
        return [step for each in hurt for step in each.worker_died(worker, each.robot == guilty)]

    def _routed(self, routes: Routes) -> Instructions:
        """Take what is routed here and release what is routed elsewhere.

        A robot that the table does not name stays: a scheduler that has just started may not know of it yet.
        """
        if routes.epoch < self.epoch:
            self.counters["stale routing tables"] += 1
            return []
        self.epoch = routes.epoch
        steps: Instructions = []
        for robot, route in sorted(routes.routes.items()):
            instance = self.instances.get(robot)
            if route.slam_edge != self.edge:
                steps += self._release(instance) if instance is not None else []
            elif instance is None:
                steps += self._take(robot, route.epoch)
            else:
                instance.rerouted(route.epoch)
        return [*steps, Claim()]

    def _release(self, instance: Instance) -> Instructions:
        del self.instances[instance.robot]
        self.counters.update(_dropped(instance))
        self.lives[instance.robot] = instance.life
        return [Release(instance.robot, instance.life, instance.worker)]

    def _take(self, robot: str, epoch: Epoch) -> Instructions:
        load = Counter(each.worker for each in self.instances.values() if each.phase is not Phase.FINAL)
        worker = min(range(self.workers), key=lambda number: (load[number], number))
        life = self.lives.get(robot, self.first_life)
        keeping = Keeping(self.keep_frames, self.keep_s)
        instance = Instance(robot, epoch, worker, self.window, life, self.turns, keeping)
        self.instances[robot] = instance
        if robot in self.profiles:
            instance.stream = self.profiles[robot].stream
        return [Listen(robot, life + 1), *instance.open(), *self._end_known(instance)]

    def _end_known(self, instance: Instance) -> Instructions:
        """The end of the robot's stream may have been told before the instance took up that stream."""
        end = self.ends.get(instance.robot)
        if end is None or instance.stream not in ("", end.stream):
            return []
        return instance.stream_ended(end.stream, end.last_seq)


def _dropped(instance: Instance) -> dict[str, int]:
    return {"frames too early": instance.backlog.overrun, "frames of another stream": instance.foreign}
