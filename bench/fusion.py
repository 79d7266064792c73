"""Fusion on real logs: how many pairs of maps are merged rightly, how many wrongly, and what a decision costs.

    RECSLAM_DATA=... python -m bench.fusion [--pairs 150] [--strangers 300] [--seed 0]

Maps are cut from the logs of three buildings by their corrected poses (see bench.cuts); a merge is right within
0.2 m and 2 degrees of the truth. Strangers are pairs that share nothing: of one building, or of two. The group `slam`
are maps that the graph kernel made of two to four stretches of a log (see bench.slam_cuts): bent, so that no rigid
placement is exact, and right within 0.4 m and 3 degrees.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bench.cuts import BUILDINGS, Cut, cuts, error, load_scans
from bench.slam_cuts import slam_pairs, slam_strangers
from common.fusion.match import Match, match, track
from common.fusion.matchmap import MatchMap
from common.fusion.picture import overlay, write_png
from common.fusion.warmup import warmup

RIGHT = (0.2, math.radians(2))
RIGHT_BENT = (0.4, math.radians(3))
OVERLAPS = {"20 %": (0.15, 0.25), "40 %": (0.35, 0.45), "60 %": (0.55, 0.65), "80 %": (0.75, 0.85)}
APART = (0.0, 0.01)
USUAL = (240_000, 360_000)
"""cells of maps of about 600 x 500, whose decision time is told apart"""
OUT = Path("results")


@dataclass(frozen=True)
class Row:
    """One pair and what became of it."""

    group: str
    building: str
    woven: bool
    overlap: float
    cells: int
    """of the two maps' rasters, mean"""
    kind: str
    right: bool
    wrong: bool
    error_m: float
    error_rad: float
    agreement: float
    conflict: float
    runner_up: float
    cold_ms: float
    """CPU time of the first decision, from the rasters"""
    track_ms: float
    reason: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=150, help="per overlap")
    parser.add_argument("--strangers", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if "RECSLAM_DATA" not in os.environ:
        raise SystemExit("set RECSLAM_DATA to the folder of real logs (see docs) to run this bench")
    warmup()
    data = Path(os.environ["RECSLAM_DATA"])
    rows = [judge(*case) for case in cases(data, options.pairs, options.strangers, options.seed)]
    report(rows)
    OUT.mkdir(exist_ok=True)
    (OUT / "fusion.json").write_text(json.dumps([asdict(row) for row in rows], indent=1))


def cases(data: Path, pairs: int, strangers: int, seed: int) -> Iterator[tuple[str, str, Cut]]:
    """(group, building, cut) for all pairs, the strangers last."""
    rng = np.random.default_rng(seed)
    some: list[tuple[str, MatchMap]] = []
    for building in BUILDINGS:
        scans = load_scans(data, building)
        for group, overlap in OVERLAPS.items():
            for cut in cuts(scans, rng, overlap, math.ceil(pairs / 3)):
                some.append((building, cut.a))
                yield group, building, cut
        for cut in cuts(scans, rng, APART, math.ceil(strangers / 6)):
            yield "apart", building, cut
    yield from (("slam", building, cut) for building, cut in slam_pairs(data))
    yield from (("slam apart", building, cut) for building, cut in slam_strangers(data))
    left = math.ceil(strangers / 2)
    while left:
        (one, a), (other, b) = (some[k] for k in rng.integers(0, len(some), 2))
        if one != other:
            left -= 1
            yield "foreign", f"{one}+{other}", Cut(a, b, np.zeros(3), 0.0, False)


def judge(group: str, building: str, cut: Cut) -> Row:
    """Decide one pair from its rasters and compare with the truth."""
    a, b = (MatchMap(m.occupancy, m.origin_cell, m.resolution, m.ground) for m in (cut.a, cut.b))
    began = time.process_time()
    result = match(a, b)
    decided = time.process_time()
    if result.transform is not None:
        track(a, b, result.transform)
    tracked = time.process_time()
    gap = error(result.transform, cut) if result.transform is not None else (math.inf, math.inf)
    near = RIGHT_BENT if group == "slam" else RIGHT
    right = (group == "slam" or group in OVERLAPS) and gap[0] < near[0] and gap[1] < near[1]
    wrong = result.kind == "merged" and not right
    if wrong:
        picture(result, a, b, f"wrong-{group}-{building}-{result.score:.0f}")
    return Row(
        group=group,
        building=building,
        woven=cut.woven,
        overlap=cut.overlap,
        cells=(a.occupancy.size + b.occupancy.size) // 2,
        kind=result.kind,
        right=right,
        wrong=wrong,
        error_m=gap[0],
        error_rad=gap[1],
        agreement=result.agreement,
        conflict=result.conflict,
        runner_up=result.runner_up,
        cold_ms=(decided - began) * 1e3,
        track_ms=(tracked - decided) * 1e3,
        reason=result.reason,
    )


def picture(result: Match, a: MatchMap, b: MatchMap, name: str) -> None:
    """Write the best hypothesis to results/."""
    OUT.mkdir(exist_ok=True)
    write_png(str(OUT / f"{name}.png"), overlay(a, b, result.hypotheses[0].pose))


def report(rows: Iterable[Row]) -> None:
    """Print the tables."""
    rows = list(rows)
    print(f"{'group':10} {'building':14} {'pairs':>5} {'right':>6} {'wrong':>5} {'p95 m':>6}  other verdicts")
    for group in dict.fromkeys(row.group for row in rows):
        chosen = [row for row in rows if row.group == group]
        for building in [*dict.fromkeys(row.building for row in chosen), "all"]:
            line([row for row in chosen if building in ("all", row.building)], group, building)
    for name, some in (("all", rows), ("about 600 x 500 cells", [r for r in rows if USUAL[0] <= r.cells <= USUAL[1]])):
        cold, tracked = [r.cold_ms for r in some], [r.track_ms for r in some if r.kind == "merged"]
        if not tracked:
            continue
        print(f"{name} ({len(some)}): decision {np.median(cold):.0f} ms CPU (median), ", end="")
        print(f"{np.percentile(cold, 95):.0f} ms (95 %); track {np.median(tracked):.1f} ms")


def line(rows: list[Row], group: str, building: str) -> None:
    """One line of the table."""
    right = [row.error_m for row in rows if row.right]
    others = Counter(row.kind for row in rows if row.kind != "merged")
    p95 = f"{np.percentile(right, 95):.3f}" if right else "-"
    told = ", ".join(f"{kind} {count}" for kind, count in sorted(others.items()))
    share = f"{len(right) / len(rows):.0%}"
    print(f"{group:10} {building:14} {len(rows):5} {share:>6} {sum(r.wrong for r in rows):5} {p95:>6}  {told}")


if __name__ == "__main__":
    main()
