"""Verdicts about all pairs of some robots' maps, remembered by map version.

A pair is decided anew only when a map has changed enough to matter; a merged pair is tracked, and where other pairs
tell how two maps lie, it is only checked there. So what a live fleet costs grows with its overlaps and not with the
square of its size. For final maps the verdict is made from nothing but the two maps, so that whoever decides it, and
in whatever order, comes to the same.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from common.fusion.cycles import Measurement
from common.fusion.match import Match, match, track
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.fusion.settings import FusionSettings
from common.fusion.solve import Solved
from common.geometry.se2 import Pose, between, wrap
from common.wire.base import PoseTuple
from common.wire.cloud import Transforms
from common.wire.edge import Component, PairVerdict

GROWTH = 0.1
"""share of new known cells from which on an undecided pair is looked at again"""

START_M, START_RAD = 0.6, 0.2
"""how far start poses may be off for telling which of two ways is meant"""

Pair = tuple[str, str]


class Place(NamedTuple):
    """Where a robot's map was found to lie."""

    component: str
    pose: ArrayLike
    """(3,) of the map's frame in the component's, or in the world"""


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
    sizes: dict[Pair, tuple[int, int]] = field(default_factory=dict)
    """known cells of both maps when the pair was last looked at everywhere"""
    checks: int = 0
    """how many times a pair was looked at everywhere"""

    def put(self, robot: str, map_: MatchMap, version: int, final: bool) -> None:
        """The robot's present map; verdicts about older ones stay until the pair is decided again."""
        self.known[robot] = Known(map_, version, final)

    def forget(self, robot: str) -> None:
        self.known.pop(robot, None)
        for pair in [pair for pair in self.verdicts if robot in pair]:
            del self.verdicts[pair]
            self.sizes.pop(pair, None)

    def decide(self, pairs: Iterable[Pair], placed: Mapping[str, Place] = {}) -> None:
        """Bring the verdicts about these pairs up to the present maps. Pairs of unknown robots are passed over.

        `placed` tells where robots were found to lie before; it spares searching, but never decides on final maps.
        """
        for a, b in pairs:
            if a in self.known and b in self.known:
                self._decide(a, b, placed)

    def told_by_starts(
        self, verdicts: Iterable[PairVerdict], starts: Mapping[str, ArrayLike]
    ) -> dict[Pair, Measurement]:
        """Transforms of pairs that look alike in several ways, where start poses tell which way is meant."""
        out: dict[Pair, Measurement] = {}
        for each in verdicts:
            if each.kind != "ambiguous" or not {each.a, each.b} <= starts.keys() & self.known.keys():
                continue
            told = between(starts[each.a], starts[each.b])
            found = track(self.known[each.a].map, self.known[each.b].map, told, settings=self.settings)
            if found.transform is not None and found.information is not None and _near(found.transform, told):
                out[each.a, each.b] = Measurement(found.transform, found.information)
        return out

    def _decide(self, a: str, b: str, placed: Mapping[str, Place]) -> None:
        first, second, old = self.known[a], self.known[b], self.verdicts.get((a, b))
        versions, final = (first.version, second.version), first.final and second.final
        if old is not None and old.versions == versions and old.final == final:
            return
        found: Match | None = None
        if final:
            found = self._everywhere(a, b)
        elif old is not None and old.transform is not None:
            found = track(first.map, second.map, old.transform, settings=self.settings)
            if found.kind != "merged":
                found = self._everywhere(a, b)
        elif old is None or self._has_grown(a, b):
            found = self._where_placed(a, b, placed) or self._everywhere(a, b)
        if found is None:
            assert old is not None
            self.verdicts[a, b] = old.model_copy(update={"versions": versions})
            return
        self.verdicts[a, b] = verdict(found, a, b, versions, final)

    def _where_placed(self, a: str, b: str, placed: Mapping[str, Place]) -> Match | None:
        """The verdict by the places that other pairs give the two, None when they must be looked for."""
        old = self.verdicts.get((a, b))
        one, other = placed.get(a), placed.get(b)
        if one is None or other is None or one.component != other.component:
            return None
        if old is not None and old.kind not in ("no_overlap", "insufficient"):
            return None  # what speaks against the placement needs an answer
        first, second, pose = self.known[a].map, self.known[b].map, between(one.pose, other.pose)
        shared = shared_area(first, second, pose)
        if shared < self.settings.min_overlap_m2:
            return Match("no_overlap", f"where other pairs put them they share {shared:.0f} m^2")
        found = track(first, second, pose, settings=self.settings)
        return found if found.kind == "merged" else None

    def _everywhere(self, a: str, b: str) -> Match:
        first, second = self.known[a].map, self.known[b].map
        self.checks += 1
        self.sizes[a, b] = (first.known_cells, second.known_cells)
        return match(first, second, settings=self.settings, seed=seed_of(a, b))

    def _has_grown(self, a: str, b: str) -> bool:
        before = self.sizes.get((a, b), (0, 0))
        now = (self.known[a].map.known_cells, self.known[b].map.known_cells)
        return any(new > (1 + GROWTH) * old for new, old in zip(now, before, strict=True))


def _near(pose: Pose, other: Pose) -> bool:
    gap = pose - other
    return bool(np.hypot(gap[0], gap[1]) <= START_M and abs(wrap(gap[2])) <= START_RAD)


def seed_of(a: str, b: str) -> int:
    """What the pair's random choices are drawn from, wherever it is decided."""
    return zlib.crc32(f"{a}/{b}".encode())


def verdict(found: Match, a: str, b: str, versions: tuple[int, int], final: bool) -> PairVerdict:
    """The message about a decided pair, complete with what `solve` needs."""
    information = None if found.information is None else tuple(float(v) for v in found.information.ravel())
    return found.verdict(a, b, versions).model_copy(update={"information": information, "final": final})


def measurements(verdicts: Iterable[PairVerdict]) -> dict[Pair, Measurement]:
    """The merged ones among the verdicts, as `solve` takes them."""
    out: dict[Pair, Measurement] = {}
    for each in verdicts:
        if each.transform is not None:
            pose = np.asarray(each.transform, np.float64)
            if each.information is None:
                out[each.a, each.b] = Measurement(pose)
            else:
                out[each.a, each.b] = Measurement(pose, np.asarray(each.information, np.float64).reshape(3, 3))
    return out


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
