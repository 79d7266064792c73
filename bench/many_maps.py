"""Fusion of many maps: how many are placed, how well, and how many full searches it takes.

    RECSLAM_DATA=... python -m bench.many_maps [--seeds 3] [--growth] [--building intel ...]

Fleets of 3, 4, 6 and 12 maps are cut from the logs of three buildings by their corrected poses: stretches of the drive
that overlap in time, of which one robot has the even and the next the odd scans, each map in a hidden frame of any
orientation. Every pair that shares 10 m^2 is compared with the truth. `--growth` goes on to 24 maps and draws the
searches beside k (k - 1) / 2. Times are CPU seconds from nothing but the rasters.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.cuts import BUILDINGS, Cut, Scans, draw_map, error, load_scans
from bench.lines import draw_lines
from bench.results import RESULTS, append
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.fusion.pairs import PairTable, all_pairs
from common.fusion.settings import FusionSettings
from common.fusion.solve import solve
from common.fusion.verdicts import measurements
from common.fusion.warmup import warmup
from common.geometry import between

FLEETS = (3, 4, 6, 12)
GROWTH = (3, 4, 6, 12, 18, 24)
RIGHT_M, RIGHT_RAD = 0.2, math.radians(2)


@dataclass(frozen=True)
class Row:
    """One fleet and what became of it."""

    building: str
    maps: int
    seed: int
    placed: int
    """maps in the largest component"""
    searches: int
    overlapping: int
    """pairs that share what a merge must rest on"""
    cpu_s: float
    wrong: int
    """overlapping pairs of one component farther than 0.2 m or 2 degrees from the truth"""
    errors_m: tuple[float, ...]
    """of overlapping pairs of one component"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--building", action="append", choices=BUILDINGS)
    options = parser.parse_args()
    if "RECSLAM_DATA" not in os.environ:
        raise SystemExit("set RECSLAM_DATA to the folder of real logs (see docs) to run this bench")
    warmup()
    rows: list[Row] = []
    sizes = sorted({*FLEETS, *GROWTH}) if options.growth else FLEETS
    for building in options.building or BUILDINGS:
        scans = load_scans(Path(os.environ["RECSLAM_DATA"]), building)
        for maps in sizes:
            found = [judge(scans, building, maps, seed) for seed in range(options.seeds)]
            print(line(building, found), flush=True)
            rows += found
    for maps in sizes:
        print(line("all", [row for row in rows if row.maps == maps]))
    append("many_maps", {"growth" if options.growth else "fleets": [asdict(row) for row in rows]})
    if options.growth:
        plot(rows, RESULTS / "many-maps.png")


def judge(scans: Scans, building: str, maps: int, seed: int) -> Row:
    """Cut a fleet of maps, fuse it from nothing, and compare it with the truth."""
    rasters, frames = fleet(scans, maps, np.random.default_rng([seed, maps]))
    began = time.process_time()
    table = PairTable()
    for name, (cells, origin, resolution) in rasters.items():
        table.put(name, MatchMap.of(cells, origin, resolution), 1, True)
    table.decide(all_pairs(rasters))
    components = solve(sorted(rasters), measurements(table.verdicts.values()))
    took = time.process_time() - began
    errors, overlapping, wrong = [], 0, 0
    for a, b in combinations(sorted(rasters), 2):
        pair, truth = (table.known[a].map, table.known[b].map), between(frames[a], frames[b])
        if shared_area(*pair, truth) < FusionSettings().min_overlap_m2:
            continue
        overlapping += 1
        for each in components:
            if a in each.robots and b in each.robots:
                estimate = between(each.transforms[a], each.transforms[b])
                gap = error(estimate, Cut(*pair, truth, 0.0, False))
                errors.append(gap[0])
                wrong += gap[0] > RIGHT_M or gap[1] > RIGHT_RAD
    placed = max(len(each.robots) for each in components)
    return Row(building, maps, seed, placed, table.checks, overlapping, took, wrong, tuple(errors))


Raster = tuple[NDArray[np.int8], tuple[int, int], float]


def fleet(
    scans: Scans, maps: int, rng: np.random.Generator
) -> tuple[dict[str, Raster], dict[str, NDArray[np.float64]]]:
    """Rasters by robot, and the hidden poses (3,) of their frames in the reference's."""
    count = len(scans.poses)
    length = int(count * min(0.5, 2 / maps + 0.03))
    spare = (count - length) / (maps - 1)
    rasters, frames = {}, {}
    for k in range(maps):
        start = int(np.clip(k * spare + rng.uniform(-0.2, 0.2) * spare, 0, count - length))
        chosen = np.arange(start, start + length)
        chosen = chosen[chosen % 2 == k % 2]
        frame = np.array([*(scans.poses[chosen[0], :2] + rng.uniform(-20, 20, 2)), rng.uniform(-math.pi, math.pi)])
        grid = draw_map(scans, chosen, frame)
        rasters[f"r{k:02}"], frames[f"r{k:02}"] = (*grid.occupancy(), grid.resolution), frame
    return rasters, frames


def line(building: str, rows: list[Row]) -> str:
    errors = [gap for row in rows for gap in row.errors_m]
    maps, cpu = rows[0].maps, np.median([row.cpu_s for row in rows])
    whole = sum(row.placed == maps for row in rows)
    return (
        f"{building:6} {maps:2} maps: all placed in {whole} of {len(rows)}, error {np.median(errors):.3f} m median, "
        f"{np.percentile(errors, 95):.3f} m 95 %, {sum(row.wrong for row in rows)} of {len(errors)} wrong; "
        f"{max(row.searches for row in rows)} searches at most for {np.mean([row.overlapping for row in rows]):.0f} "
        f"overlaps of {maps * (maps - 1) // 2} pairs, {cpu:.2f} s CPU"
    )


def plot(rows: list[Row], path: Path) -> None:
    """Searches and overlapping pairs over the number of maps, means, beside all pairs."""
    sizes = sorted({row.maps for row in rows})

    def mean(what: str) -> list[tuple[float, float]]:
        return [(k, float(np.mean([getattr(row, what) for row in rows if row.maps == k]))) for k in sizes]

    every = [(float(k), k * (k - 1) / 2) for k in sizes]
    lines = {"k (k - 1) / 2": every, "overlapping pairs": mean("overlapping"), "searches": mean("searches")}
    draw_lines(lines, "maps k", "pairs", path)


if __name__ == "__main__":
    main()
