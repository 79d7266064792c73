"""What an edge worker decides about preparative fusion: whose maps it fetches, and when it fuses.

The routing table names the robots whose maps are fused here; their SLAM may run on other edges. A map is fetched when
another notice of it has come than the one that the last fetch followed, from the edge that runs the robot *now*.
Fusion runs when something has changed, one at a time, and again when something changed meanwhile.
"""

from __future__ import annotations

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
    """A robot map lies in the fusion worker, as its edge showed it when it was asked."""

    fetch: Fetch
    version: int
    cover: Cover
    final: bool


@dataclass(frozen=True)
class FetchFailed:
    fetch: Fetch


@dataclass(frozen=True)
class Fused:
    """A fusion has ended; one that failed is tried again at the next tick."""

    well: bool


@dataclass(frozen=True)
class Tick:
    """Every `map_every_s`."""


Event = Routed | MapNoticed | WorldSeen | Fetched | FetchFailed | Fused | Tick


@dataclass(frozen=True)
class Fetch:
    """Fetch what the notice tells of, and put it on top of what is held since that version (0: nothing is)."""

    notice: MapNotice
    since: int


@dataclass(frozen=True)
class Forget:
    """The robot's map is not fused here any more, or must be taken anew."""

    robot: str


@dataclass(frozen=True)
class Fuse:
    """Fuse these maps, on the lattice of the world if the transforms of it are known."""

    robots: tuple[str, ...]
    world: Transforms | None
    whole: bool
    """these are all robots that are fused here"""


Instruction = Fetch | Forget | Fuse


@dataclass
class Held:
    """A robot map as it lies in the fusion worker."""

    notice: MapNotice
    """what it was fetched after; what came may be newer"""
    version: int
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
    fetching: dict[str, Fetch] = field(default_factory=dict)
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
            case FetchFailed(fetch):
                if self.fetching.get(fetch.notice.robot) is fetch:
                    del self.fetching[fetch.notice.robot]
            case Fused(well):
                self.busy = False
                self.changed = self.changed or not well
                return self._fuse() if well and self.all_final() else []
            case Tick():
                return [*self._fetch_all(), *self._fuse()]
        return []

    def all_final(self) -> bool:
        """Every member's map is held in its final version."""
        return bool(self.members) and all(robot in self.held and self.held[robot].final for robot in self.members)

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert set(self.held) <= set(self.members), "a map is held that is not fused here"
        assert set(self.fetching) <= set(self.members)
        for robot, held in self.held.items():
            assert (held.notice.edge, held.notice.epoch) == self.members[robot], "a map of an earlier owner is held"

    def _routed(self, routes: Routes) -> list[Instruction]:
        if routes.epoch < self.epoch:
            return []
        self.epoch = routes.epoch
        members = {
            robot: (route.slam_edge, route.epoch)
            for robot, route in routes.routes.items()
            if route.fuse_edge == self.edge
        }
        changed = {robot for robot, owner in self.members.items() if members.get(robot) != owner}
        stale = sorted(changed & set(self.held))
        for robot in changed:
            self.held.pop(robot, None)
            self.fetching.pop(robot, None)
        if members != self.members:
            self.changed = True
        self.members = members
        return [*(Forget(robot) for robot in stale), *self._fetch_all()]

    def _fetch_all(self) -> list[Instruction]:
        return [step for robot in sorted(self.members) for step in self._fetch(robot)]

    def _fetch_final(self, notice: MapNotice) -> list[Instruction]:
        return self._fetch(notice.robot) if notice.final and notice.robot in self.members else []

    def _fetch(self, robot: str) -> list[Instruction]:
        edge, epoch = self.members[robot]
        notice, held = self.notices.get((robot, edge)), self.held.get(robot)
        if notice is None or notice.epoch != epoch or robot in self.fetching:
            return []
        if held is not None and held.notice == notice:
            return []
        step = Fetch(notice, held.version if held is not None else 0)
        self.fetching[robot] = step
        return [step]

    def _fetched(self, event: Fetched) -> list[Instruction]:
        robot = event.fetch.notice.robot
        if self.fetching.get(robot) is not event.fetch:  # re-routed meanwhile: what came is of an earlier owner
            return [Forget(robot)] if robot not in self.fetching and robot not in self.held else []
        del self.fetching[robot]
        if event.cover.epoch != event.fetch.notice.epoch:
            self.held.pop(robot, None)
            return [Forget(robot)]  # the edge has taken the robot up anew: another notice will come
        self.held[robot] = Held(event.fetch.notice, event.version, event.final)
        self.changed = True
        return self._fuse() if self.all_final() else self._fetch(robot)

    def _world_seen(self, transforms: Transforms) -> None:
        if transforms != self.world:
            self.changed = True
        self.world = transforms

    def _fuse(self) -> list[Instruction]:
        if self.busy or not self.changed:
            return []
        self.busy, self.changed = True, False
        return [Fuse(tuple(sorted(self.held)), self.world, bool(self.members) and set(self.held) == set(self.members))]
