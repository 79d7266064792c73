"""What the relation error of a trajectory on the Intel log owes to SLAM, to the log's stamps, and to the relations.

    RECSLAM_DATA=... python -m bench.slam --kernel graph --log intel_dense
    RECSLAM_DATA=... python -m bench.slam_relations results/slam-graph-intel_dense.tum

Relations name scans of the full log by their stamps. This log leaves most scans out and keeps all odometry, whose
stamps it rounds to six digits of the seconds since its start: to 10 ms for the most part. A scan that is left out is
found again as the odometry row next to it, so `by row` matches relations with rows of the log instead of times:

* a stamp of a scan that was read, digit for digit: that scan;
* one within `EXACT_S` of such a scan: so many rows further in the log, as rows that waited are written `ROW_S` apart;
* otherwise the row that has this stamp but for the rounding, if all such rows are in one place; else it is not scored.

The pose at a row is carried by odometry from the scans before and after it in the order of the lines, and blended.
"""

from __future__ import annotations

import argparse
import gzip
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.slam import LOGS, RELATIONS, STRICT_S, data
from common.evaluation.relations import EXACT_S, read_odometry, read_relations, score_relations
from common.formats.tum import read_trajectory
from common.geometry import between, compose, wrap

ROW_S = 1.05e-3
"""s between rows that the logger wrote after it had waited: the median over stamps less than 1.5 ms apart"""
ONE_PLACE_M = 0.01
TOLERANCES_S = (1e-4, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, EXACT_S, 1e-2)
DIGITS = 6
"""of the seconds since the log's start, in odometry rows"""


class Rows:
    """The rows of the log in the order of its lines, and the poses of a trajectory at them."""

    def __init__(self, path: Path, trajectory: NDArray[np.float64]) -> None:
        rows, scan, half = [], [], []
        with gzip.open(path, "rt") as lines:
            for fields in map(str.split, lines):
                if fields[0] in ("ODOM", "FLASER"):
                    tail = fields[1:4] + fields[7:] if fields[0] == "ODOM" else fields[5 + int(fields[1]) :]
                    rows.append([float(tail[k]) for k in (3, 0, 1, 2)])
                    scan.append(fields[0] == "FLASER")
                    half.append(0.5 * 10.0 ** (np.floor(np.log10(max(float(tail[5]), 1e-3))) + 1 - DIGITS))
        table = np.array(rows)
        self.stamps, self.odometry = table[:, 0], table[:, 1:]
        self.is_scan, self.rounding = np.array(scan), np.array(half)
        self.scans, self.readings = np.flatnonzero(self.is_scan), np.flatnonzero(~self.is_scan)
        nearest = np.abs(trajectory[:, None, 0] - self.stamps[None, self.scans]).argmin(axis=0)
        self.poses = trajectory[nearest, 1:]
        """(scans, 3)"""
        step = np.abs(np.diff(self.odometry, axis=0))
        self.way = np.append(0.0, np.cumsum(np.hypot(step[:, 0], step[:, 1]) + np.abs(wrap(step[:, 2]))))

    def named(self, stamp: float) -> int | None:
        """The row that a relation means by a stamp; None where several rows of different places may be meant."""
        scan = self.scans[np.abs(self.stamps[self.scans] - stamp).argmin()]
        late = stamp - self.stamps[scan]
        if abs(late) <= STRICT_S:
            return int(scan)
        if abs(late) <= EXACT_S:
            own = self._reading(scan)
            steps = int(np.sign(late)) * max(round(abs(late) / ROW_S), 1)
            return int(self.readings[np.clip(own + steps, 0, len(self.readings) - 1)])
        off = np.abs(self.stamps[self.readings] - stamp)
        rows = self.readings[off <= self.rounding[self.readings] + 2 * STRICT_S]
        alone = len(rows) > 0 and np.hypot(*np.ptp(self.odometry[rows, :2], axis=0)) <= ONE_PLACE_M
        return int(rows[0]) if alone else None

    def _reading(self, scan: np.intp) -> int:
        """Which of the odometry rows belongs to a scan: the one of its pose, as a rule in the line before."""
        near = np.searchsorted(self.readings, scan) - 1 + np.array([0, 1, -1, 2, -2, 3, -3])
        near = near[(near >= 0) & (near < len(self.readings))]
        off = np.abs(self.odometry[self.readings[near]] - self.odometry[scan]).max(axis=1)
        return int(near[np.round(off, 5).argmin()])

    def pose(self, row: int) -> NDArray[np.float64]:
        """The trajectory's pose (3,) at a row."""
        after = int(np.clip(np.searchsorted(self.scans, row), 1, len(self.scans) - 1))
        ends = [after - 1, after]
        a, b = (compose(self.poses[k], between(self.odometry[self.scans[k]], self.odometry[row])) for k in ends)
        start, end = self.way[self.scans[ends]]
        share = np.clip((self.way[row] - start) / max(end - start, 1e-9), 0.0, 1.0)
        return compose(a, between(a, b) * share)


def by_row(rows: Rows, relations: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors (n,) of a trajectory and of the log's raw odometry in metres, by row; NaN where a stamp names no row."""
    named = {stamp: rows.named(stamp) for stamp in np.unique(relations[:, :2])}
    ours, odometry = np.full((2, len(relations)), np.nan)
    for k, (first, second, *said) in enumerate(relations):
        a, b = named[first], named[second]
        if a is not None and b is not None:
            ours[k] = apart(between(rows.pose(a), rows.pose(b)), said)
            odometry[k] = apart(between(rows.odometry[a], rows.odometry[b]), said)
    return ours, odometry


def triangles(relations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres (n,) by which three relations among three scans contradict each other, without any trajectory."""
    told: dict[tuple[float, float], NDArray[np.float64]] = {}
    for first, second, *said in relations:
        told[first, second] = np.array(said)
        told[second, first] = between(np.array(said), np.zeros(3))
    near: dict[float, set[float]] = {}
    for first, second in told:
        near.setdefault(first, set()).add(second)
    return np.array([
        apart(compose(told[a, b], told[b, c]), told[a, c])
        for a in near for b, c in combinations(sorted(s for s in near[a] if s > a), 2) if c in near[b]
    ])  # fmt: skip


def apart(a: NDArray[np.float64], b: NDArray[np.float64] | list[float]) -> float:
    return float(np.hypot(a[0] - b[0], a[1] - b[1]))


def told(name: str, errors: NDArray[np.float64]) -> None:
    print(f"{name:58s} {len(errors):5d}  {errors.mean():.4f} +- {errors.std():.4f} m, median {np.median(errors):.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trajectory", type=Path, help="TUM file, one pose a scan")
    trajectory = read_trajectory(parser.parse_args().trajectory)
    log, relations = data() / LOGS["intel_dense"][0], read_relations(data() / RELATIONS)
    score = score_relations(relations, read_odometry(log), [trajectory])
    told("all, by stamp", score.translation)
    for tolerance in TOLERANCES_S:
        near = score_relations(relations, read_odometry(log), [trajectory], exact_s=tolerance).exact
        told(f"  estimates within {1e3 * tolerance:g} ms of both stamps", score.translation[near])
    ours, odometry = by_row(Rows(log, trajectory), relations)
    known, exact = np.isfinite(ours), score.exact
    told("by row, all that name one", ours[known])
    told("  the same by stamp", score.translation[known])
    told("by stamp, those that name none", score.translation[~known])
    told("by row, those called exact", ours[known & exact])
    far = known & exact & (score.translation > 0.05)
    told("by row, of these the ones off by more than 5 cm by stamp", ours[far])
    told("  the same by stamp", score.translation[far])
    told("three relations among three scans contradict by", triangles(relations))
    print(f"{int((odometry[known] < 1e-3).sum())} relations say what raw odometry says, within a millimetre")


if __name__ == "__main__":
    main()
