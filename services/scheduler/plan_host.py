"""What runs inside the scheduler's planning process: footprints, the overlap matrix and the policy."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from common.errors import UsageError
from common.geometry.se2 import compose
from common.grid.raster import Raster
from common.grid.tiles import decode_occupancy
from common.wire import OverlapMatrix, Placed, Transforms, decode, encode
from services.scheduler.costs import FusionModel, Ints, Problem, predict
from services.scheduler.graph import Weights, cut, quantise
from services.scheduler.grouping import balanced_grouping
from services.scheduler.overlap import (
    Cells,
    Footprint,
    Overlap,
    cells_of_raster,
    cells_of_route,
    lattice_cells,
    overlap_matrix,
)
from services.scheduler.policies import plan
from services.scheduler.regrouping import relabelled
from services.scheduler.settling import settle

MAP_BYTES_PER_M2 = 380.0
"""of compressed tiles, measured on a robot map of the apartment (329 scans, 76 m2 known)"""
MATRIX_ROBOTS = 512
"""with more robots the overlap matrix is not shown: it would hold up everything else (and 1024 fill a message)"""
SETTLING = 0.3
"""share of the time budget, on top of it, for regrouping by overlap"""
SENSOR_M = 8.0
"""reach of a laser whose profile does not say"""


class PlanHost:
    """Called through common.workers; arguments and results are plain msgpack values."""

    def __init__(self) -> None:
        self._sketches: dict[str, Raster] = {}

    def put_sketch(self, robot: str, resolution: float, tiles: list[tuple[int, int, bytes]]) -> None:
        """The whole sketch of a robot map. Raises BadMessage when it is none; the one before stays then."""
        raster = Raster(resolution)
        raster.replace(((x, y), decode_occupancy(data, robot)) for x, y, data in tiles)
        self._sketches[robot] = raster

    def plan(
        self,
        robots: list[dict[str, Any]],
        edges: list[dict[str, Any]],
        transforms: bytes | None,
        policy: str,
        budget_s: float,
        kappa: int,
        tau: int,
        hysteresis: float,
        fusion: list[float],
        horizon: float,
        noise: dict[str, float],
    ) -> dict[str, Any]:
        """An assignment of the robots to the edges, compared with the present one, and the overlap matrix.

        `robots`: name, reach (list of edge names or None), start, range_max, frame_bytes, bandwidth (one an edge),
        slam_s, pack_s, move_s (to build its map anew elsewhere), slam, fuse; `edges`: name, speed, bandwidth, cores;
        `fusion`: the three coefficients of the model; `horizon`: rounds over which a move must pay off; `noise`: of
        what is measured, as shares, by stage. Times and bytes are those of one round. A robot that lies where nobody
        can be counts as one of whom nothing is known, and `problems` name it.
        """
        world = decode(transforms) if transforms is not None else None
        problems: list[str] = []
        placed = world.robots if isinstance(world, Transforms) else {}
        footprints = [self._footprint(robot, placed, problems) for robot in robots]
        overlap = overlap_matrix(footprints)
        problem = make_problem(robots, edges, overlap.weights, footprints, FusionModel(*fusion), horizon)
        made = plan(problem, policy, budget_s=budget_s, kappa=kappa, tau=tau)
        names = [edge["name"] for edge in edges]
        weights = quantise(problem.weights)
        if policy == "recslam":
            begin = time.perf_counter()
            chosen = settle(
                problem,
                weights,
                made.slam,
                made.fuse,
                lambda: balanced_grouping(weights, len(edges), kappa, tau),
                noise,
                hysteresis,
                lambda: (time.perf_counter() - begin) / (SETTLING * budget_s),
            )
            chosen_slam, chosen_fuse, why = chosen
        else:
            chosen_slam = problem.current_slam
            chosen_fuse, why = self._regrouped(problem, weights, made.fuse, hysteresis)
        prediction = predict(problem, chosen_slam, chosen_fuse)
        groups = {name: [robots[v]["name"] for v in np.flatnonzero(chosen_fuse == e)] for e, name in enumerate(names)}
        total = float(weights.sum()) / 2
        return {
            "slam": {robot["name"]: names[e] for robot, e in zip(robots, chosen_slam, strict=True)},
            "fuse": {robot["name"]: names[e] for robot, e in zip(robots, chosen_fuse, strict=True)},
            "groups": groups,
            "in_group": {
                name: float(weights[np.ix_(chosen_fuse == e, chosen_fuse == e)].sum()) / 2
                for e, name in enumerate(names)
            },
            "cut": float(cut(weights, chosen_fuse)),
            "total_weight": total,
            "predicted": {
                "t_c": prediction.total,
                "cloud": prediction.cloud,
                **{f"{stage.what} {stage.where}": stage.seconds for stage in prediction.critical},
            },
            "alternative": made.alternative,
            "reason": f"{why}; {made.reason}" if why else made.reason,
            "seconds": made.seconds,
            "overlap": encode(_shown(overlap)) if len(robots) <= MATRIX_ROBOTS else None,
            "problems": problems,
        }

    def _regrouped(self, problem: Problem, weights: Weights, fuse: Ints, hysteresis: float) -> tuple[Ints, str]:
        """Fusing edges of the groups of a policy that does not look at time, or the present ones, and why these.

        They stay when they are of even sizes and the others' cut is not smaller by the share `hysteresis`.
        """
        present = problem.current_fuse
        fuse = relabelled(fuse, present, problem.reachable)
        sizes = np.bincount(np.maximum(present, 0), minlength=len(problem.edges))
        if (present < 0).any() or sizes.max() - sizes.min() > 1:
            return fuse, ""
        if float(cut(weights, present) - cut(weights, fuse)) > hysteresis * float(weights.sum()) / 2:
            return fuse, ""
        return present, "kept: no grouping is closer by enough"

    def _footprint(self, robot: dict[str, Any], world: Mapping[str, Placed], problems: list[str]) -> Footprint:
        name = robot["name"]
        raster, placed = self._sketches.get(name), world.get(name)
        try:
            if raster is not None and placed is not None:
                return Footprint(name, placed.component, _covered(raster, placed), "map")
            if robot["start"] is not None:
                reach = robot["range_max"] or SENSOR_M
                return Footprint(name, "starts", cells_of_route([robot["start"][:2]], min(reach, SENSOR_M)), "start")
        except UsageError as error:
            problems.append(f"robot/{name}: {error}")
        return Footprint(name, f"unknown {name}", np.empty(0, dtype=np.int64), "unknown")


def _covered(raster: Raster, placed: Placed) -> Cells:
    cells, origin = raster.dense()
    corner = compose(placed.transform.pose(), (*(np.array(origin) * raster.resolution), 0.0))
    return cells_of_raster(cells != -1, raster.resolution, corner)


def _shown(overlap: Overlap) -> OverlapMatrix:
    weights = np.ascontiguousarray(overlap.weights, dtype=np.float64).ravel()
    return OverlapMatrix(robots=overlap.robots, weights=weights, source=overlap.sources())


def make_problem(
    robots: list[dict[str, Any]],
    edges: list[dict[str, Any]],
    weights: np.ndarray,
    footprints: list[Footprint],
    fusion: FusionModel,
    horizon: float,
) -> Problem:
    """The planner's view of what has been measured."""
    names = [edge["name"] for edge in edges]
    reachable = np.array([[robot["reach"] is None or name in robot["reach"] for name in names] for robot in robots])

    def column(key: str) -> np.ndarray:
        return np.array([robot[key] for robot in robots], dtype=np.float64)

    def present(key: str) -> np.ndarray:
        return np.array([names.index(robot[key]) if robot[key] in names else -1 for robot in robots], dtype=np.int64)

    return Problem(
        robots=tuple(robot["name"] for robot in robots),
        edges=tuple(names),
        weights=weights,
        footprints=lattice_cells(footprints),
        reachable=reachable,
        robot_bandwidth=np.array([robot["bandwidth"] for robot in robots], dtype=np.float64),
        edge_bandwidth=np.array([edge["bandwidth"] for edge in edges], dtype=np.float64),
        speed=np.array([edge["speed"] for edge in edges], dtype=np.float64),
        cores=np.array([edge["cores"] for edge in edges], dtype=np.int64),
        frame_bytes=column("frame_bytes"),
        slam_s=column("slam_s"),
        pack_s=column("pack_s"),
        current_slam=present("slam"),
        current_fuse=present("fuse"),
        move_cost=column("move_s"),
        horizon=horizon,
        fusion=fusion,
        map_bytes_per_m2=MAP_BYTES_PER_M2,
    )
