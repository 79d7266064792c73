"""What an edge worker decides about preparative fusion: whose maps it fetches, and when it fuses.

The routing table names the robots whose maps are fused here; their SLAM may run on other edges. A map is fetched when
its version is newer than what is held, from the edge that runs the robot *now*. Fusion runs when something has
changed, one at a time, and again when something changed meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from common.wire import Cover, Epoch, MapNotice, Routes, Transforms


@dataclass(frozen=True)
class Routed:
    routes: Routes


@dataclass(frozen=True)
class MapNoticed:
    notice: MapNotice


@dataclass(frozen=True)
class WorldSeen:
    """The cloud has published transforms."""

    transforms: Transforms


@dataclass(frozen=True)
class Fetched:
    robot: str
    edge: str
    version: int
    cover: Cover | None
    final: bool


@dataclass(frozen=True)
class FetchFailed:
    robot: str


@dataclass(frozen=True)
class Fused:
    """A fusion has ended, well or not."""


@dataclass(frozen=True)
class Tick:
    """Every `map_every_s`."""


Event = Routed | MapNoticed | WorldSeen | Fetched | FetchFailed | Fused | Tick


@dataclass(frozen=True)
class Fetch:
    robot: str
    edge: str
    since: int


@dataclass(frozen=True)
class Forget:
    """The robot's map is not fused here any more, or must be taken anew."""

    robot: str


@dataclass(frozen=True)
class Fuse:
    """Fuse the maps held, on the lattice of the world if the transforms of it are known."""

    robots: tuple[str, ...]
    world: Transforms | None


Instruction = Fetch | Forget | Fuse


@dataclass
class Held:
    """A robot map as it lies in the fusion worker."""

    edge: str
    epoch: Epoch
    version: int
    cover: Cover | None
    final: bool


@dataclass
class FusingState:
    """The robots fused at one edge."""

    edge: str
    epoch: Epoch = (0, 0)
    members: dict[str, tuple[str, Epoch]] = field(default_factory=dict)
    """robot → (edge that runs it, epoch of that)"""
    notices: dict[tuple[str, str], MapNotice] = field(default_factory=dict)
    """(robot, edge) → latest"""
    held: dict[str, Held] = field(default_factory=dict)
    fetching: set[str] = field(default_factory=set)
    world: Transforms | None = None
    busy: bool = False
    changed: bool = False

    def handle(self, event: Event) -> list[Instruction]:
        match event:
            case Routed(routes):
                return self._routed(routes)
            case MapNoticed(notice):
                self.notices[notice.robot, notice.edge] = notice
                return self._fetch_final(notice)
            case WorldSeen(transforms):
                self._world_seen(transforms)
                return self._fuse() if transforms.final else []
            case Fetched():
                return self._fetched(event)
            case FetchFailed(robot):
                self.fetching.discard(robot)
            case Fused():
                self.busy = False
                return self._fuse() if self.all_final() else []
            case Tick():
                return [*self._fetch_all(), *self._fuse()]
        return []

    def all_final(self) -> bool:
        """Every member's map is held in its final version."""
        return bool(self.members) and all(robot in self.held and self.held[robot].final for robot in self.members)

    def covers(self, robots: Mapping[str, object]) -> dict[str, Cover]:
        """What an edge map of these robots contains."""
        return {robot: cover for robot in robots if robot in self.held and (cover := self.held[robot].cover)}

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert set(self.held) <= set(self.members), "a map is held that is not fused here"
        assert self.fetching <= set(self.members)

    def _routed(self, routes: Routes) -> list[Instruction]:
        if routes.epoch < self.epoch:
            return []
        self.epoch = routes.epoch
        members = {
            robot: (route.slam_edge, route.epoch)
            for robot, route in routes.routes.items()
            if route.fuse_edge == self.edge
        }
        stale = [
            robot
            for robot, held in self.held.items()
            if robot not in members or (held.edge, held.epoch) != members[robot]
        ]
        for robot in stale:
            del self.held[robot]
        if stale or set(members) != set(self.members):
            self.changed = True
        self.members = members
        self.fetching &= set(members)
        return [*(Forget(robot) for robot in sorted(stale)), *self._fetch_all()]

    def _fetch_all(self) -> list[Instruction]:
        return [step for robot in sorted(self.members) for step in self._fetch(robot)]

    def _fetch_final(self, notice: MapNotice) -> list[Instruction]:
        return self._fetch(notice.robot) if notice.final and notice.robot in self.members else []

    def _fetch(self, robot: str) -> list[Instruction]:
        edge, epoch = self.members[robot]
        notice, held = self.notices.get((robot, edge)), self.held.get(robot)
        if notice is None or notice.epoch != epoch or robot in self.fetching:
            return []
        steps: list[Instruction] = []
        if held is not None and held.version > notice.version:  # the instance was started again: a map of its own
            del self.held[robot]
            steps, held = [Forget(robot)], None
        if held is not None and held.version == notice.version and held.final == notice.final:
            return []
        self.fetching.add(robot)
        return [*steps, Fetch(robot, edge, held.version if held is not None else 0)]

    def _fetched(self, event: Fetched) -> list[Instruction]:
        self.fetching.discard(event.robot)
        edge, epoch = self.members.get(event.robot, ("", (0, 0)))
        if event.edge != edge:  # re-routed meanwhile: what came is of another life
            return [Forget(event.robot)]
        self.held[event.robot] = Held(edge, epoch, event.version, event.cover, event.final)
        self.changed = True
        return self._fuse() if self.all_final() else self._fetch(event.robot)

    def _world_seen(self, transforms: Transforms) -> None:
        if self.world is None or transforms.world_epoch != self.world.world_epoch:
            self.changed = True
        self.world = transforms

    def _fuse(self) -> list[Instruction]:
        if self.busy or not self.changed or (not self.held and not self.members):
            return []
        self.busy, self.changed = True, False
        return [Fuse(tuple(sorted(self.held)), self.world)]
