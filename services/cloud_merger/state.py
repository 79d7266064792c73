"""What the cloud decides: whose sketches and edge maps it fetches, when it solves, and when it composes.

Live, the world follows what comes: transforms are solved anew when sketches or verdicts have changed, edges render
onto the world they are told, and the global map is the sum of the edge maps of the present world epoch. Once every
robot's map is final, the *final* world is solved canonically, from nothing but the final maps, and the global map
that results is the same however robots were grouped. Events in, instructions out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from common.fusion.cycles import Pair
from common.fusion.pairs import all_pairs, complete
from common.wire import Covers, EdgeMapNotice, Epoch, MapNotice, PairVerdict, Routes, Transforms
from services.cloud_merger.changes import changed, parted
from services.cloud_merger.events import (
    Compose,
    Composed,
    EdgeMapNoticed,
    Event,
    FetchFailed,
    FetchPart,
    FetchSketch,
    Forget,
    Instruction,
    MapNoticed,
    PartFetched,
    Routed,
    SketchFetched,
    Solve,
    Solved,
    Tick,
    VerdictsCame,
)
from services.cloud_merger.parts import Part, together

PATIENCE = 3
"""ticks for which the global map waits rather than shrink: until edges have rendered onto a new world, or until the
edge that a robot has come to shows it"""
UNSEEN = 100
"""worlds above those shown that an earlier cloud may have told: an edge that is late with one must not seem in ours"""


@dataclass
class CloudState:
    expected: tuple[str, ...] = ()
    """robots that must have come before anything is final (a batch run's)"""
    epoch: Epoch = (0, 0)
    members: dict[str, tuple[str, str, Epoch]] = field(default_factory=dict)
    """robot → (edge that runs it, edge that fuses it, epoch)"""
    notices: dict[tuple[str, str], MapNotice] = field(default_factory=dict)
    """(robot, edge) → latest"""
    sketches: dict[str, MapNotice] = field(default_factory=dict)
    """robot → notice whose sketch is held"""
    verdicts: dict[str, dict[Pair, PairVerdict]] = field(default_factory=dict)
    """edge → its verdicts"""
    edge_maps: dict[str, EdgeMapNotice] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)
    world: Transforms | None = None
    settled: dict[str, int] | None = None
    """versions from which the final world was solved"""
    fetching: dict[str, FetchSketch | FetchPart] = field(default_factory=dict)
    """robot/<rid> or edge/<eid> → the fetch under way"""
    solving: bool = False
    composing: Covers | None = None
    """what the map being composed contains"""
    waited: int = 0
    """ticks since the last composition on which the map would have shrunk"""
    shown: Covers = field(default_factory=dict)
    """what the global map contains"""
    changed: bool = False
    """sketches or verdicts are newer than the world"""
    composed: tuple[object, ...] = ()
    """what the global map was last composed of"""
    counters: Counter[str] = field(default_factory=Counter)

    def handle(self, event: Event) -> list[Instruction]:
        match event:
            case Routed(routes):
                return self._routed(routes)
            case MapNoticed(notice):
                self.notices[notice.robot, notice.edge] = notice
                return self._fetch_sketch(notice.robot) if notice.final else []
            case EdgeMapNoticed(notice):
                self.edge_maps[notice.edge] = notice
                return self._fetch_part(notice.edge) if notice.final else []
            case VerdictsCame(edge, verdicts):
                pairs = {(each.a, each.b): each for each in verdicts.pairs}
                self.changed = self.changed or pairs != self.verdicts.get(edge)
                self.verdicts[edge] = pairs
                return self._solve() if self.ready_to_settle() else []
            case SketchFetched(fetch):
                return self._sketch_fetched(fetch)
            case PartFetched():
                return self._part_fetched(event)
            case FetchFailed(fetch):
                if self._ended(fetch):
                    self.counters["fetches failed"] += 1
                return []
            case Solved(transforms):
                return self._solved(transforms)
            case Composed(well):
                return self._was_composed(well)
            case Tick():
                fetches = [step for robot in sorted(self.members) for step in self._fetch_sketch(robot)]
                parts = [step for edge in self.fusing_edges() for step in self._fetch_part(edge)]
                self.waited += self._shrinking()
                return [*fetches, *parts, *self._solve(), *self._compose()]

    def fusing_edges(self) -> list[str]:
        return sorted({fuser for _, fuser, _ in self.members.values()})

    def slam_edges(self) -> dict[str, str]:
        """The edge that runs each robot."""
        return {robot: edge for robot, (edge, _, _) in self.members.items()}

    def final_versions(self) -> dict[str, int] | None:
        """Version of every robot's final map; None while one is missing."""
        versions = {}
        for robot in {*self.members, *self.expected}:
            notice = self._current(robot)
            held = self.sketches.get(robot)
            if notice is None or not notice.final or held is None:
                return None
            if (held.version, held.final, held.edge) != (notice.version, True, notice.edge):
                return None
            versions[robot] = notice.version
        return versions or None

    def ready_to_settle(self) -> bool:
        """All is final that the final world rests on, and it has not been solved from exactly this."""
        versions = self.final_versions()
        if versions is None or versions == self.settled or self.solving:
            return False
        return all(
            complete(self.verdicts.get(edge, {}), all_pairs(self._fused_at(edge)), versions)
            for edge in self.fusing_edges()
        )

    def empty_handed(self) -> CloudState:
        """What has been heard, after the process that held sketches and edge maps has died."""
        heard = CloudState(self.expected, self.epoch, self.members, self.notices, verdicts=self.verdicts)
        heard.edge_maps, heard.world, heard.counters = self.edge_maps, self.world, self.counters
        return heard

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert set(self.sketches) <= set(self.members)
        assert self.settled is None or self.world is not None

    def _routed(self, routes: Routes) -> list[Instruction]:
        if routes.epoch < self.epoch:
            return []
        self.epoch = routes.epoch
        self.members = {
            robot: (route.slam_edge, route.fuse_edge, route.epoch) for robot, route in routes.routes.items()
        }
        gone = sorted(set(self.sketches) - set(self.members))
        for robot in gone:
            del self.sketches[robot]
        self.changed = True
        return [Forget(robot) for robot in gone]

    def _current(self, robot: str) -> MapNotice | None:
        """The latest notice of the edge that runs the robot now, of its present epoch."""
        if robot not in self.members:
            return None
        edge, _, epoch = self.members[robot]
        notice = self.notices.get((robot, edge))
        return notice if notice is not None and notice.epoch == epoch else None

    def _fused_at(self, edge: str) -> list[str]:
        return sorted(robot for robot, (_, fuser, _) in self.members.items() if fuser == edge)

    def _ended(self, fetch: FetchSketch | FetchPart) -> bool:
        """Whether the fetch is the one under way; it is no more then."""
        name = fetch.name
        if self.fetching.get(name) is not fetch:
            return False
        del self.fetching[name]
        return True

    def _fetch(self, fetch: FetchSketch | FetchPart) -> list[Instruction]:
        if fetch.name in self.fetching:
            return []
        self.fetching[fetch.name] = fetch
        return [fetch]

    def _fetch_sketch(self, robot: str) -> list[Instruction]:
        notice = self._current(robot)
        return [] if notice is None or notice == self.sketches.get(robot) else self._fetch(FetchSketch(notice))

    def _sketch_fetched(self, fetch: FetchSketch) -> list[Instruction]:
        robot = fetch.notice.robot
        if not self._ended(fetch):
            return []
        if robot not in self.members:
            return [Forget(robot)]
        self.sketches[robot] = fetch.notice
        self.changed = True
        return [*self._fetch_sketch(robot), *(self._solve() if self.ready_to_settle() else [])]

    def _fetch_part(self, edge: str) -> list[Instruction]:
        notice, part = self.edge_maps.get(edge), self.parts.get(edge)
        if notice is None or notice.world_epoch == 0 or (part is not None and part.notice == notice):
            return []
        return self._fetch(FetchPart(notice, part.version if part is not None else 0))

    def _part_fetched(self, event: PartFetched) -> list[Instruction]:
        edge = event.fetch.notice.edge
        if not self._ended(event.fetch):
            return []
        self.parts[edge] = Part(event.fetch.notice, event.version, event.world_epoch, event.covers, event.final)
        return [*self._compose(), *self._fetch_part(edge)]

    def _solve(self) -> list[Instruction]:
        final = self.ready_to_settle()
        # worlds that come faster than edges render would never be seen whole
        live = self.changed and self.final_versions() is None and not self._held()
        if self.solving or not self.sketches or not (final or live):
            return []
        self.solving, self.changed = True, False
        robots = tuple(sorted(self.sketches))
        by_edges = {pair: edge for edge in self.fusing_edges() for pair in all_pairs(self._fused_at(edge))}
        told = [self.verdicts.get(edge, {}).get(pair) for pair, edge in by_edges.items()]
        theirs = tuple(verdict for verdict in told if verdict is not None)
        # which final pairs need a search depends on all maps, so only who has all can tell
        pairs = tuple(pair for pair in all_pairs(robots) if final or pair not in by_edges)
        above = max([notice.world_epoch for notice in self.edge_maps.values()], default=0)
        above += UNSEEN if above and self.world is None else 0
        return [Solve(robots, pairs, theirs, final, self.world, above)]

    def _solved(self, transforms: Transforms | None) -> list[Instruction]:
        self.solving = False
        if transforms is None:
            self.counters["solves failed"] += 1
            self.changed = True
            return []
        if self.world is not None:
            self.counters["un-merges"] += len(parted(transforms.robots, self.world.robots))
        self.world = transforms
        if transforms.final:
            self.settled = {robot: placed.version for robot, placed in transforms.robots.items()}
        return self._compose()

    def _compose(self) -> list[Instruction]:
        if self.world is None or self.composing is not None or self._held():
            return []
        parts = self._rendered()
        covers = together(parts, self._fused_at)
        if covers is None:
            return []
        final = self.world.final and bool(covers) and all(part.final for part in parts.values())
        final = final and covers == self._final_covers() and self.settled == self.final_versions()
        if self.world.final and not final:
            return []  # never show less than the final map while its parts come in
        versions = {edge: part.version for edge, part in parts.items()}
        makeup = (self.world.world_epoch, final, versions)
        if makeup == self.composed or not covers:
            return []
        self.composing, self.composed, self.waited = covers, makeup, 0
        return [Compose(versions, self.world, covers, final, changed(covers, self.shown))]

    def _was_composed(self, well: bool) -> list[Instruction]:
        covers, self.composing = self.composing, None
        if not well:
            self.composed = ()
            return []
        self.shown = covers or {}
        return self._compose()

    def _rendered(self) -> dict[str, Part]:
        """Edge maps of the present world."""
        epoch = self.world.world_epoch if self.world is not None else 0
        held = {edge: self.parts[edge] for edge in self.fusing_edges() if edge in self.parts}
        return {edge: part for edge, part in held.items() if part.world_epoch == epoch}

    def _held(self) -> bool:
        """The map as it is shown is better than what could be shown now, and has not been for long."""
        return self.waited < PATIENCE and self._shrinking()

    def _shrinking(self) -> bool:
        """The global map would lose for a moment what it shows.

        An edge's map is still of an earlier world, or a robot has left one edge's map and is not in another's yet.
        """
        rendered = self._rendered()
        if self.parts.keys() & set(self.fusing_edges()) != rendered.keys():
            return True
        covers = together(rendered, self._fused_at)
        return covers is not None and not self.shown.keys() & self.members.keys() <= covers.keys()

    def _final_covers(self) -> Covers | None:
        """What the final map must contain, all of every robot; None while one has no map of its present epoch."""
        current = {robot: self._current(robot) for robot in self.members}
        covers = {robot: notice.cover for robot, notice in current.items() if notice is not None}
        return covers if covers.keys() == current.keys() else None
