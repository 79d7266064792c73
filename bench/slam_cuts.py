"""Pairs of maps that robots made: one real log cut by time among two to four robots, each with a hidden start, and
mapped by the graph kernel. Unlike maps drawn from reference poses they are bent by drift.

Maps are kept in results/slam-maps, to be made once; delete the folder to have them made anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.cuts import Cut
from common.evaluation.trajectory import associate, fit
from common.formats.carmen import CarmenLog
from common.formats.segments import cut, hide_start
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import shared_area
from common.geometry import between
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack

LOGS = {
    "intel": ("logs/intel_dense.raw.log.gz", "reference/intel.ref.txt.gz"),
    "aces": ("logs/aces.raw.log.gz", "reference/aces.ref.txt.gz"),
    "csail": ("logs/mit-csail.clf.gz", "reference/csail.ref.txt.gz"),
}
PARTS = (2, 3, 4)
KEPT = Path("results/slam-maps")
MAX_GAP_S = 10.0


class Made(NamedTuple):
    """One robot's map, and where its frame lies."""

    building: str
    cut: tuple[int, int]
    """(part, parts)"""
    map: MatchMap
    frame: NDArray[np.float64]
    """(3,) pose of the map's frame in the reference's, fitted to the whole trajectory"""
    trajectory: NDArray[np.float64]
    """(n, 4) stamp s, x m, y m, theta rad in the map's frame"""


def slam_pairs(data: Path) -> Iterator[tuple[str, Cut]]:
    """(building, cut) of all pairs of one fleet; `truth` is as good as rigid frames can be for bent maps."""
    for a, b in combinations(made(data), 2):
        if a.building == b.building and a.cut[1] == b.cut[1]:
            truth = between(a.frame, b.frame)
            smaller = min(a.map.known_m2, b.map.known_m2)
            yield a.building, Cut(a.map, b.map, truth, shared_area(a.map, b.map, truth) / smaller, False)


def slam_strangers(data: Path) -> Iterator[tuple[str, Cut]]:
    """(buildings, cut) of all pairs of maps of different buildings."""
    for a, b in combinations(made(data), 2):
        if a.building != b.building:
            yield f"{a.building}+{b.building}", Cut(a.map, b.map, np.zeros(3), 0.0, False)


def made(data: Path) -> list[Made]:
    """Every robot's map of every cut of every log."""
    return [_made(data, building, part, parts) for building in LOGS for parts in PARTS for part in range(parts)]


def _made(data: Path, building: str, part: int, parts: int) -> Made:
    path = KEPT / f"{building}-{part}-{parts}.npz"
    if not path.exists():
        _make(data / LOGS[building][0], part, parts, path)
    with np.load(path) as kept:
        x, y = (int(v) for v in kept["origin"])
        map_ = MatchMap.of(kept["occupancy"], (x, y), float(kept["resolution"]))
        trajectory = kept["trajectory"]
    ours, theirs = associate(np.loadtxt(data / LOGS[building][1]), trajectory, MAX_GAP_S)
    return Made(building, (part, parts), map_, fit(theirs[:, 1:3], ours[:, 1:3]), trajectory)


def _make(log: Path, part: int, parts: int, path: Path) -> None:
    kernel = create("graph", {}, 0)
    for seq, sweep in enumerate(hide_start(cut(CarmenLog(log), part, parts), seed=10 * parts + part)):
        kernel.process(pack(sweep, "robot", "0" * 32, seq))
    kernel.finish()
    grid = kernel.map()
    occupancy, origin = grid.occupancy()
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, occupancy=occupancy, origin=origin, resolution=grid.resolution, trajectory=kernel.trajectory())
