"""Fusion where rooms are alike: how often two stretches of drawn buildings that share nothing are merged all the same.

    python -m bench.rooms_alike [--buildings 24] [--strangers 300] [--seed 0]

Buildings of 53 x 12 m with rooms of random widths on both sides of one corridor, a door in each, and hardly a thing in
them. Maps are stretches of 11 m every 6 m, in frames of their own, with ragged walls. All pairs of one building are
decided, and some of two buildings. This is harder than any real log at hand: whatever four walls and two cross walls
allow happens here.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.fusion.match import match
from common.fusion.matchmap import MatchMap
from common.fusion.warmup import warmup
from common.geometry import between, inverse
from common.grid import Grid
from common.grid.render import render

RESOLUTION_M = 0.05
LENGTH_M, DEPTH_M = 53.0, 12.0
STRETCH_M, EVERY_M, STRETCHES = 11.0, 6.0, 8
ROOM_M, DOOR_M = (2.2, 4.5), 0.9
THINGS = 14
MISSED = 0.1
"""share of wall cells that no laser hit"""
RIGHT = (0.2, math.radians(2))

Counts = NDArray[np.uint16]


class Stretch(NamedTuple):
    map: MatchMap
    frame: NDArray[np.float64]
    """(3,) pose of the map's frame in the building's"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--buildings", type=int, default=24)
    parser.add_argument("--strangers", type=int, default=300, help="pairs of two buildings")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warmup()
    rng = np.random.default_rng(options.seed)
    buildings = [stretches(building(rng), rng) for _ in range(options.buildings)]
    told: Counter[tuple[str, str]] = Counter()
    for each in buildings:
        for (i, a), (j, b) in combinations(enumerate(each), 2):
            told["neighbours" if j == i + 1 else "apart", judge(a, b, j == i + 1)] += 1
    for _ in range(options.strangers):
        one, other = rng.choice(len(buildings), 2, replace=False)
        told["foreign", judge(*(buildings[k][rng.integers(STRETCHES)] for k in (one, other)), False)] += 1
    for group in ("neighbours", "apart", "foreign"):
        found = {kind: count for (where, kind), count in sorted(told.items()) if where == group}
        print(f"{group:10} {sum(found.values()):4} pairs: " + ", ".join(f"{kind} {n}" for kind, n in found.items()))


def judge(a: Stretch, b: Stretch, near: bool) -> str:
    """`right`, `wrong`, or the verdict that was no merge; only neighbours can be merged rightly."""
    found = match(a.map, b.map)
    if found.transform is None:
        return found.kind
    gap = between(between(a.frame, b.frame), found.transform)
    return "right" if near and math.hypot(gap[0], gap[1]) < RIGHT[0] and abs(gap[2]) < RIGHT[1] else "wrong"


def building(rng: np.random.Generator) -> Counts:
    """Counts (2, h, w) of a building with a border of 10 unknown cells."""
    height, width = (round(size / RESOLUTION_M) for size in (DEPTH_M, LENGTH_M))
    counts = np.zeros((2, height + 20, width + 20), np.uint16)
    counts[1, 10:-10, 10:-10] = 20
    outline(counts, 0.0, 0.0, LENGTH_M, DEPTH_M)
    corridor = DEPTH_M * rng.uniform(0.3, 0.4), DEPTH_M * rng.uniform(0.5, 0.62)
    for y, outer in zip(corridor, (0.0, DEPTH_M), strict=True):
        x = 0.0
        while x < LENGTH_M:
            end = min(x + rng.uniform(*ROOM_M), LENGTH_M)
            door = x + rng.uniform(0.3, max(0.4, end - x - DOOR_M - 0.3))
            wall(counts, x, y, min(door, end), y)
            wall(counts, min(door + DOOR_M, end), y, end, y)
            wall(counts, end, min(y, outer), end, max(y, outer))
            x = end
    for _ in range(THINGS):
        x, y = rng.uniform(0.5, LENGTH_M - 2), rng.uniform(0.5, DEPTH_M - 2)
        outline(counts, x, y, x + rng.uniform(0.3, 1.3), y + rng.uniform(0.3, 1.3))
    return counts


def stretches(counts: Counts, rng: np.random.Generator) -> list[Stretch]:
    """What robots map of the building, one stretch each."""
    found = []
    for k in range(STRETCHES):
        first, last = (round(x / RESOLUTION_M) + 10 for x in (EVERY_M * k, EVERY_M * k + STRETCH_M))
        known = counts.copy()
        known[:, :, :first] = known[:, :, last:] = 0
        known[0, (known[0] > 0) & (rng.random(known[0].shape) < MISSED)] = 0
        frame = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi)])
        grid = render(Grid.from_dense(known, (-10, -10), RESOLUTION_M), inverse(frame), RESOLUTION_M)
        found.append(Stretch(MatchMap.from_grid(grid), frame))
    return found


def outline(counts: Counts, x0: float, y0: float, x1: float, y1: float) -> None:
    """Four walls around a rectangle, m from the building's lower left corner."""
    for ends in ((x0, y0, x1, y0), (x0, y1, x1, y1), (x0, y0, x0, y1), (x1, y0, x1, y1)):
        wall(counts, *ends)


def wall(counts: Counts, x0: float, y0: float, x1: float, y1: float) -> None:
    """A wall along one axis; its outermost cells are the building's own."""
    limits = np.array(counts.shape[:0:-1]) - 11
    (c0, r0), (c1, r1) = (
        np.minimum(np.array(end) / RESOLUTION_M + 10, limits).astype(int) for end in ((x0, y0), (x1, y1))
    )
    counts[0, r0 : r1 + 1, c0 : c1 + 1] = counts[1, r0 : r1 + 1, c0 : c1 + 1]


if __name__ == "__main__":
    main()
