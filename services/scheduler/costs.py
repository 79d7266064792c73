"""Predicted completion time t_c of an assignment: Eqs. 1-3 of the paper.

    t_r = pack + transfer(r → e) + SLAM(e) [+ price of moving, spread over the horizon]      (Eq. 1)
    t_e = max over the robots that e fuses of (t_r [+ transfer of the robot map e' → e]) + fuse(e)   (Eq. 2)
    t_c = max over e of (t_e + transfer(e → cloud)) + fuse(cloud)                            (Eq. 3)

The terms in brackets are ours: a robot's SLAM edge may differ from the edge that fuses its map, and to move an instance
costs once what is gained in every round. An edge with more SLAM instances than cores slows all of them down alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import UsageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class FusionModel:
    """Seconds at speed 1 to fuse k maps into one that covers `area` m²: k map + k (k - 1) / 2 pair + area m2."""

    map_s: float = 0.03
    """features of one map"""
    pair_s: float = 0.02
    """matching one pair: what makes fusion quadratic in k"""
    m2_s: float = 2e-4
    """composing one square metre"""

    def seconds(self, maps: ArrayLike, area: ArrayLike) -> Floats:
        k = np.asarray(maps, dtype=np.float64)
        return np.where(
            k > 0, self.map_s * k + self.pair_s * k * (k - 1) / 2 + self.m2_s * np.asarray(area, dtype=np.float64), 0.0
        )


@dataclass(frozen=True)
class Problem:
    """All that a plan depends on. V robots, E edges; arrays are in the order of `robots` and of `edges`."""

    robots: tuple[str, ...]
    edges: tuple[str, ...]
    weights: Floats
    """(V, V) overlap matrix, symmetric, zero diagonal"""
    footprints: tuple[Ints, ...]
    """per robot the distinct ids of the lattice cells its map covers, in a frame common to all; may be empty"""
    reachable: NDArray[np.bool_]
    """(V, E): a robot's SLAM and fusing edge are chosen among these"""
    robot_bandwidth: Floats
    """(V, E) bytes/s from a robot to an edge"""
    edge_bandwidth: Floats
    """(E,) bytes/s from an edge to the cloud"""
    speed: Floats
    """(E,) relative computing speed"""
    cores: Ints
    """(E,)"""
    frame_bytes: Floats
    """(V,) bytes that a robot sends in a round"""
    slam_s: Floats
    """(V,) seconds of SLAM in a round at speed 1"""
    pack_s: Floats
    """(V,) seconds"""
    current_slam: Ints
    """(V,) edge that runs the robot's SLAM now, -1 for none"""
    current_fuse: Ints
    """(V,) edge that fuses the robot's map now, -1 for none"""
    move_cost: Floats
    """(V,) seconds to move the robot's SLAM instance to another edge, once"""
    horizon: float = 10.0
    """rounds over which the price of a move is spread"""
    fusion: FusionModel = FusionModel()
    cloud_speed: float = 1.0
    map_bytes_per_m2: float = 2000.0
    cell_m2: float = 1.0
    """area of one lattice cell"""

    def __post_init__(self) -> None:
        robots, edges = len(self.robots), len(self.edges)
        shapes = {
            "weights": (robots, robots),
            "reachable": (robots, edges),
            "robot_bandwidth": (robots, edges),
            **dict.fromkeys(("edge_bandwidth", "speed", "cores"), (edges,)),
            **dict.fromkeys(
                ("frame_bytes", "slam_s", "pack_s", "current_slam", "current_fuse", "move_cost"), (robots,)
            ),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise UsageError(f"Problem.{name}: shape {np.shape(getattr(self, name))}, must be {shape}")
        if len(self.footprints) != robots:
            raise UsageError(
                f"Problem.footprints: {len(self.footprints)} for {robots} robots; give one, maybe empty, each"
            )
        for name in ("robot_bandwidth", "edge_bandwidth", "speed", "cores", "cloud_speed", "horizon"):
            if not (np.asarray(getattr(self, name)) > 0).all():
                raise UsageError(f"Problem.{name}: must be above 0; say by `reachable` that a link is down")
        if edges == 0:
            raise UsageError("Problem.edges: no edge to plan for; start one")
        stranded = [robot for robot, row in zip(self.robots, self.reachable, strict=True) if not row.any()]
        if stranded:
            raise UsageError(f"Problem.reachable: {', '.join(stranded)} reaches no edge; leave it out until it does")

    @cached_property
    def map_m2(self) -> Floats:
        """(V,) area of each robot map; one of which nothing is known counts as an average one."""
        areas = np.array([cells.size for cells in self.footprints], dtype=np.float64) * self.cell_m2
        known = areas[areas > 0]
        return np.where(areas > 0, areas, known.mean() if known.size else 0.0)

    @cached_property
    def edge_to_edge(self) -> Floats:
        """(E, E) bytes/s between two edges: that of the slower uplink; infinite on the diagonal."""
        pairs = np.minimum(self.edge_bandwidth[:, None], self.edge_bandwidth[None, :])
        np.fill_diagonal(pairs, np.inf)
        return pairs


@dataclass(frozen=True)
class Stage:
    """One step on the critical path."""

    what: str
    """pack, transfer, slam, move, carry, fuse, upload or merge"""
    where: str
    """the robot or edge, or `cloud`"""
    seconds: float


@dataclass(frozen=True)
class Prediction:
    """Predicted times in seconds."""

    total: float
    """t_c"""
    robots: Floats
    """(V,) t_r"""
    edges: Floats
    """(E,) t_e, 0 for an edge that fuses nothing"""
    uploads: Floats
    """(E,) transfer of the edge map to the cloud"""
    cloud: float
    """fusion at the cloud"""
    critical: tuple[Stage, ...]
    """the stages, in order, that sum up to `total`"""


def union_m2(problem: Problem, members: Ints) -> float:
    """Area in m² that the maps of these robots cover together."""
    cells = [problem.footprints[robot] for robot in members]
    return float(np.unique(np.concatenate(cells)).size) * problem.cell_m2 if cells else 0.0


def predict(problem: Problem, slam: Ints, fuse: Ints) -> Prediction:
    """t_c when robot v has its SLAM on edge `slam[v]` and its map fused on edge `fuse[v]`, both (V,)."""
    if not len(problem.robots):
        zeros = np.zeros(len(problem.edges))
        return Prediction(0.0, np.zeros(0), zeros, zeros.copy(), 0.0, ())
    every, count = np.arange(len(slam)), len(problem.edges)
    load = np.maximum(1.0, np.bincount(slam, minlength=count) / problem.cores) / problem.speed
    transfer = problem.frame_bytes / problem.robot_bandwidth[every, slam]
    work = problem.slam_s * load[slam]
    bytes_of_map = problem.map_m2 * problem.map_bytes_per_m2
    carry = bytes_of_map / problem.edge_to_edge[slam, fuse]
    fetched_anew = (fuse != problem.current_fuse) & (problem.current_fuse >= 0)
    moved = (slam != problem.current_slam) & (problem.current_slam >= 0)
    move = (moved * problem.move_cost + fetched_anew * carry) / problem.horizon
    robots = problem.pack_s + transfer + work + move
    ready = robots + carry
    maps = np.bincount(fuse, minlength=count)
    areas = np.array([union_m2(problem, np.flatnonzero(fuse == edge)) for edge in range(count)])
    fusing = problem.fusion.seconds(maps, areas) / problem.speed
    last = np.zeros(count)
    np.maximum.at(last, fuse, ready)
    uploads = areas * problem.map_bytes_per_m2 / problem.edge_bandwidth
    arrivals = last + fusing + uploads
    hot = int(np.argmax(arrivals))
    everything = union_m2(problem, every)
    cloud = float(problem.fusion.seconds(int((maps > 0).sum()), everything)) / problem.cloud_speed
    slowest = int(np.argmax(np.where(fuse == hot, ready, -np.inf)))
    robot, runner, fuser = problem.robots[slowest], problem.edges[slam[slowest]], problem.edges[hot]
    critical = (
        Stage("pack", robot, float(problem.pack_s[slowest])),
        Stage("transfer", robot, float(transfer[slowest])),
        Stage("slam", runner, float(work[slowest])),
        Stage("move", robot, float(move[slowest])),
        Stage("carry", fuser, float(carry[slowest])),
        Stage("fuse", fuser, float(fusing[hot])),
        Stage("upload", fuser, float(uploads[hot])),
        Stage("merge", "cloud", cloud),
    )
    return Prediction(float(arrivals[hot]) + cloud, robots, last + fusing, uploads, cloud, critical)
