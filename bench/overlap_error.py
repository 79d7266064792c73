"""The overlap matrix that the scheduler makes out of robot maps, against that of true footprints, in the apartment."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from common.geometry.se2 import compose
from common.grid.raster import Raster
from common.sim.robot import SimulatedRobot
from common.sim.scene import load_scene
from common.sim.truth import visible_area
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack
from services.scheduler.overlap import Footprint, cells_of_points, cells_of_raster, cells_of_route, overlap_matrix

FINE_M = 0.1
STREAM = "0" * 32


def overlap_error(robots: int, seconds: float, lidar: str) -> dict[str, Any]:
    """Errors of w over all pairs of robots that have driven `seconds` of their routes, from maps and from starts.

    Maps are the graph kernel's, placed by true start poses: what is measured is coverage, not fusion.
    """
    scene = load_scene("apartment")
    names = [f"r{number + 1}" for number in range(robots)]
    drivers = [SimulatedRobot(scene, name, 1, lidar=lidar, duration_s=seconds, peers=names) for name in names]
    begin = time.process_time()
    mapped = [_mapped(driver) for driver in drivers]
    spent = time.process_time() - begin
    true, fine = [], []
    for driver in drivers:
        points = visible_area(scene, [driver], FINE_M)
        true.append(Footprint(driver.robot, "world", cells_of_points(points)))
        fine.append({tuple(cell) for cell in np.floor(points / FINE_M).astype(int).tolist()})
    begin = time.process_time()
    found = overlap_matrix(mapped).weights
    matrix_ms = 1e3 * (time.process_time() - begin)
    reach = drivers[0].lidar.geometry.range_max
    starts = [
        Footprint(each.robot, "world", cells_of_route([each.pose(0.0)[:2]], min(reach, 8.0)), "start")
        for each in drivers
    ]
    pairs = np.triu_indices(robots, 1)
    exact = np.array([len(fine[a] & fine[b]) / (len(fine[a]) + len(fine[b])) for a, b in zip(*pairs, strict=True)])
    lattice = overlap_matrix(true).weights[pairs]
    return {
        "robots": robots,
        "seconds": seconds,
        "lidar": lidar,
        "true w (median)": float(np.median(exact)),
        **_errors("maps", found[pairs] - exact),
        **_errors("true footprints on the 1 m lattice", lattice - exact),
        **_errors("start discs", overlap_matrix(starts).weights[pairs] - exact),
        "matrix ms": matrix_ms,
        "SLAM CPU s": spent,
    }


def _errors(what: str, off: np.ndarray) -> dict[str, float]:
    return {
        f"{what}: bias": float(off.mean()),
        f"{what}: median error": float(np.median(abs(off))),
        f"{what}: worst": float(abs(off).max()),
    }


def _mapped(driver: SimulatedRobot) -> Footprint:
    kernel = create("graph", {}, 0)
    for seq, sweep in enumerate(driver.sweeps()):
        kernel.process(pack(sweep, driver.robot, STREAM, seq))
    grid = kernel.map()
    sketch = Raster(grid.resolution)
    sketch.follow(grid)
    cells, origin = sketch.dense()
    corner = compose(driver.pose(0.0), (*(np.array(origin) * sketch.resolution), 0.0))
    return Footprint(driver.robot, "world", cells_of_raster(cells != -1, sketch.resolution, corner))
