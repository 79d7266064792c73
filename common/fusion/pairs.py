"""Verdicts about the pairs of some robots' maps, remembered by map version.

Live, a pair is searched anew only when a map has changed enough to matter, and a merged pair is tracked. For final maps
all is decided from nothing but the maps, so that whoever decides, and in whatever order, comes to the same.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from common.fusion.cycles import Measurement, Pair
from common.fusion.likeness import SIGNIFICANT, likeness
from common.fusion.match import Match, match, track
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.fusion.settings import FusionSettings
from common.fusion.solve import Solved
from common.fusion.starts import told_by_starts
from common.fusion.survey import Place, survey
from common.fusion.verdicts import verdict
from common.geometry.se2 import Pose
from common.wire.base import PoseTuple
from common.wire.cloud import Transforms
from common.wire.edge import Component, PairVerdict

GROWTH = 0.1
"""share of new known cells from which on an undecided pair is looked at again"""


@dataclass
class Known:
    """One robot's map as it takes part in matching."""

    map: MatchMap
    version: int
    final: bool


@dataclass
class PairTable:
    """Maps by robot, and what has been decided about their pairs; a pair is (a, b) with a < b."""

    settings: FusionSettings = field(default_factory=FusionSettings)
    known: dict[str, Known] = field(default_factory=dict)
    verdicts: dict[Pair, PairVerdict] = field(default_factory=dict)
    searches: dict[Pair, PairVerdict] = field(default_factory=dict)
    """final verdicts that a search gave, here or elsewhere"""
    sizes: dict[Pair, tuple[int, int]] = field(default_factory=dict)
    """known cells of both maps when the pair was last searched"""
    alike: dict[Pair, tuple[tuple[int, int], int]] = field(default_factory=dict)
    """known cells of both maps when their likeness was last told, and that"""
    checks: int = 0
    """how many times a pair was searched"""
    _told: dict[Pair, PairVerdict] = field(default_factory=dict)

    def put(self, robot: str, map_: MatchMap, version: int, final: bool) -> None:
        """The robot's present map; verdicts about older ones stay until the pair is decided again."""
        self.known[robot] = Known(map_, version, final)

    def forget(self, robot: str) -> None:
        self.known.pop(robot, None)
        for pair in [pair for pair in self.verdicts if robot in pair]:
            for table in (self.verdicts, self.searches, self.sizes, self.alike):
                table.pop(pair, None)

    def decide(self, pairs: Iterable[Pair], placed: Mapping[str, Place] = {}, told: Iterable[PairVerdict] = ()) -> None:
        """Bring the verdicts about these pairs up to the present maps. Pairs of unknown robots are passed over.

        `placed` tells where robots were found to lie before, `told` what others have decided. Both spare searching,
        but have no say on final maps; there only searches that others made of the same maps are taken over.
        """
        wanted = [pair for pair in pairs if pair[0] in self.known and pair[1] in self.known]
        final = all(self.known[robot].final for pair in wanted for robot in pair)
        others = {(each.a, each.b): each for each in told}
        if others == self._told and all(self._is_current(pair, final) for pair in wanted):
            return
        self._told = others
        if final:
            self.searches |= {pair: each for pair, each in others.items() if each.final and each.searched}
            self.verdicts |= survey(wanted, self, self.settings)
        else:
            known = {pair: each for pair, each in others.items() if pair not in wanted}
            kept = self._followed(wanted)
            self.verdicts |= survey(wanted, self, self.settings, kept=kept, told=known, placed=placed)

    def told_by_starts(
        self, verdicts: Iterable[PairVerdict], starts: Mapping[str, ArrayLike]
    ) -> dict[Pair, Measurement]:
        """Transforms of undecided pairs where start poses tell which way is meant (see common.fusion.starts)."""
        maps = {robot: known.map for robot, known in self.known.items()}
        return told_by_starts(verdicts, maps, starts, self.settings)

    def likeness(self, pair: Pair) -> int:
        """How many key points of the two maps fit together."""
        a, b = (self.known[robot] for robot in pair)
        told = self.alike.get(pair)
        if told is None or (self._sizes(pair) != told[0] if a.final and b.final else self._grown(pair, told[0])):
            told = self._sizes(pair), likeness(a.map, b.map, self.settings, seed_of(*pair))
            self.alike[pair] = told
        return told[1]

    def pass_over(self, pair: Pair) -> PairVerdict:
        """The verdict on a pair that is not worth a search."""
        reason = f"not searched: only {self.likeness(pair)} key points fit, and others fitted both maps better"
        return self._verdict(Match("no_overlap", reason), pair, searched=False)

    def verify(self, pair: Pair, pose: Pose) -> PairVerdict | None:
        """The verdict on a pair where others put it; None when it must be searched."""
        a, b = (self.known[robot].map for robot in pair)
        shared = shared_area(a, b, pose)
        if shared < self.settings.min_overlap_m2:
            if self.likeness(pair) >= SIGNIFICANT:
                return None  # much alike, and yet apart: one of the two is wrong
            reason = f"where other pairs put them they share {shared:.0f} m^2"
            return self._verdict(Match("no_overlap", reason), pair, searched=False)
        found = track(a, b, pose, settings=self.settings)
        little = found.kind == "insufficient" or (found.kind == "no_overlap" and found.score >= 0)
        return self._verdict(found, pair, searched=False) if found.kind == "merged" or little else None

    def search(self, pair: Pair) -> PairVerdict:
        """The verdict from looking for one map everywhere in the other."""
        known = self.searches.get(pair)
        if known is not None and self._is_about(known, pair, self._is_final(pair)):
            return known
        a, b = (self.known[robot].map for robot in pair)
        self.checks += 1
        self.sizes[pair] = self._sizes(pair)
        found = self._verdict(match(a, b, settings=self.settings, seed=seed_of(*pair)), pair, searched=True)
        if found.final:
            self.searches[pair] = found
        return found

    def _followed(self, pairs: Iterable[Pair]) -> dict[Pair, PairVerdict]:
        """Earlier searches that still hold: merged ones tracked, others while neither map has grown much."""
        kept: dict[Pair, PairVerdict] = {}
        for pair in pairs:
            old = self.verdicts.get(pair)
            if old is None or not old.searched:
                continue
            if old.versions == self._versions(pair):
                kept[pair] = old
            elif old.transform is not None:
                a, b = (self.known[robot].map for robot in pair)
                found = track(a, b, old.transform, settings=self.settings)
                kept[pair] = self._verdict(found, pair, searched=True) if found.kind == "merged" else self.search(pair)
            elif not self._grown(pair, self.sizes.get(pair, (0, 0))):
                kept[pair] = old.model_copy(update={"versions": self._versions(pair)})
        return kept

    def _verdict(self, found: Match, pair: Pair, *, searched: bool) -> PairVerdict:
        return verdict(found, pair, self._versions(pair), self._is_final(pair), searched)

    def _is_current(self, pair: Pair, final: bool) -> bool:
        old = self.verdicts.get(pair)
        return old is not None and self._is_about(old, pair, final)

    def _is_about(self, each: PairVerdict, pair: Pair, final: bool) -> bool:
        return each.versions == self._versions(pair) and each.final == final

    def _is_final(self, pair: Pair) -> bool:
        return all(self.known[robot].final for robot in pair)

    def _versions(self, pair: Pair) -> tuple[int, int]:
        return self.known[pair[0]].version, self.known[pair[1]].version

    def _sizes(self, pair: Pair) -> tuple[int, int]:
        return self.known[pair[0]].map.known_cells, self.known[pair[1]].map.known_cells

    def _grown(self, pair: Pair, before: tuple[int, int]) -> bool:
        return any(new > (1 + GROWTH) * old for new, old in zip(self._sizes(pair), before, strict=True))


def seed_of(a: str, b: str) -> int:
    """What the pair's random choices are drawn from, wherever it is decided."""
    return zlib.crc32(f"{a}/{b}".encode())


def places(world: Transforms | None) -> dict[str, Place]:
    """Where the world's transforms put the robots."""
    if world is None:
        return {}
    return {name: Place(each.component, each.transform.pose()) for name, each in world.robots.items()}


def component(solved: Solved) -> Component:
    """The message about robots whose relative transforms are known."""
    transforms: dict[str, PoseTuple] = {
        name: (float(pose[0]), float(pose[1]), float(pose[2])) for name, pose in solved.transforms.items()
    }
    return Component(id=solved.id, robots=solved.robots, transforms=transforms)


def all_pairs(robots: Iterable[str]) -> list[Pair]:
    """Every pair (a, b), a < b, in sorted order."""
    names = sorted(robots)
    return [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]


def complete(verdicts: Mapping[Pair, PairVerdict], pairs: Iterable[Pair], versions: Mapping[str, int]) -> bool:
    """Whether each of the pairs has a final verdict about exactly these map versions."""
    return all(
        (found := verdicts.get(pair)) is not None
        and found.final
        and found.versions == (versions.get(pair[0]), versions.get(pair[1]))
        for pair in pairs
    )
