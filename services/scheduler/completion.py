"""The predicted t_c of `costs.predict` in a form that a local search can ask for thousands of changes a second.

Kernels take the problem as `Stages` and an assignment as `Plan`, which keeps what changes little by little: how many
robots each edge serves, and how often each lattice cell is covered in each edge map, so that union areas stay exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.scheduler.costs import Floats, Ints, Problem

EVENNESS = 0.02
"""share of the mean edge time in the score, so that the search also goes where the slowest edge stays as it is"""


class Stages(NamedTuple):
    """A problem by stage; times in seconds."""

    base: Floats
    """(V, E) packing, transfer and the price of moving when SLAM runs on e"""
    slam: Floats
    """(V,) at speed 1"""
    carried: Floats
    """(V,) bytes of a robot map"""
    lag: Floats
    """(E, E) seconds a byte from edge to edge"""
    fetched: Floats
    """(V, E) how often a map is carried to e in a round: once, and its share of the first fetch"""
    speed: Floats
    cores: Floats
    upload: Floats
    """(E,) seconds a square metre"""
    fusion: Floats
    """(3,) coefficients of the fusion model"""
    merge: Floats
    """(E + 1,) fusion at the cloud by number of edge maps"""
    first: Ints
    """(V + 1,) robot v's cells are cells[first[v]:first[v + 1]]"""
    cells: Ints
    cell_m2: float
    reachable: NDArray[np.bool_]


class Plan(NamedTuple):
    """An assignment and its running counts."""

    slam: Ints
    fuse: Ints
    running: Ints
    """(E,) SLAM instances"""
    maps: Ints
    """(E,) robot maps that are fused"""
    covered: Ints
    """(E,) cells of the edge map"""
    cover: NDArray[np.int32]
    """(E, C) how many maps cover a cell"""


def stages_of(problem: Problem) -> Stages:
    moving = (np.arange(len(problem.edges)) != problem.current_slam[:, None]) & (problem.current_slam >= 0)[:, None]
    fetching = (np.arange(len(problem.edges)) != problem.current_fuse[:, None]) & (problem.current_fuse >= 0)[:, None]
    sizes = [cells.size for cells in problem.footprints]
    flat = np.concatenate([*problem.footprints, np.empty(0, dtype=np.int64)])
    distinct, cells = np.unique(flat, return_inverse=True)
    edge_maps = np.arange(len(problem.edges) + 1)
    model = problem.fusion
    return Stages(
        base=problem.pack_s[:, None]
        + problem.frame_bytes[:, None] / problem.robot_bandwidth
        + moving * problem.move_cost[:, None] / problem.horizon,
        slam=np.asarray(problem.slam_s, dtype=np.float64),
        carried=problem.map_m2 * problem.map_bytes_per_m2,
        lag=1.0 / problem.edge_to_edge,
        fetched=1.0 + fetching / problem.horizon,
        speed=np.asarray(problem.speed, dtype=np.float64),
        cores=np.asarray(problem.cores, dtype=np.float64),
        upload=problem.map_bytes_per_m2 / np.asarray(problem.edge_bandwidth, dtype=np.float64),
        fusion=np.array([model.map_s, model.pair_s, model.m2_s]),
        merge=model.seconds(edge_maps, distinct.size * problem.cell_m2) / problem.cloud_speed,
        first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        cells=cells.astype(np.int64),
        cell_m2=float(problem.cell_m2),
        reachable=np.asarray(problem.reachable, dtype=np.bool_),
    )


def plan_of(stages: Stages, slam: Ints, fuse: Ints) -> Plan:
    edges = stages.speed.size
    cover = np.zeros((edges, int(stages.cells.max(initial=-1)) + 1), dtype=np.int32)
    np.add.at(cover, (np.repeat(fuse, np.diff(stages.first)), stages.cells), 1)
    return Plan(
        slam=np.array(slam, dtype=np.int64),
        fuse=np.array(fuse, dtype=np.int64),
        running=np.bincount(slam, minlength=edges).astype(np.int64),
        maps=np.bincount(fuse, minlength=edges).astype(np.int64),
        covered=(cover > 0).sum(axis=1).astype(np.int64),
        cover=cover,
    )


@njit(cache=True)
def ready(stages, plan, v):  # type: ignore[no-untyped-def]
    """When robot v's map is at the edge that fuses it."""
    at = plan.slam[v]
    to = plan.fuse[v]
    crowd = max(1.0, plan.running[at] / stages.cores[at])
    carry = stages.carried[v] * stages.lag[at, to] * stages.fetched[v, to]
    return stages.base[v, at] + stages.slam[v] * crowd / stages.speed[at] + carry


@njit(cache=True)
def evaluate(stages, plan, arrivals):  # type: ignore[no-untyped-def]
    """(t_c, score); fills `arrivals` (E,): when each edge map is at the cloud. The search lowers the score."""
    arrivals[:] = 0.0
    for v in range(plan.slam.size):
        arrivals[plan.fuse[v]] = max(arrivals[plan.fuse[v]], ready(stages, plan, v))
    used = 0
    latest = 0.0
    total = 0.0
    for e in range(arrivals.size):
        k = plan.maps[e]
        if k > 0:
            area = plan.covered[e] * stages.cell_m2
            fuse = stages.fusion[0] * k + stages.fusion[1] * k * (k - 1) / 2 + stages.fusion[2] * area
            arrivals[e] += fuse / stages.speed[e] + area * stages.upload[e]
            used += 1
            total += arrivals[e]
            latest = max(latest, arrivals[e])
    finish = latest + stages.merge[used]
    return finish, finish + EVENNESS * total / max(used, 1)


@njit(cache=True)
def set_edges(plan, v, slam, fuse):  # type: ignore[no-untyped-def]
    """Send robot v elsewhere; the coverage is left to the caller."""
    plan.running[plan.slam[v]] -= 1
    plan.running[slam] += 1
    plan.maps[plan.fuse[v]] -= 1
    plan.maps[fuse] += 1
    plan.slam[v] = slam
    plan.fuse[v] = fuse


@njit(cache=True)
def relocate(stages, plan, v, slam, fuse):  # type: ignore[no-untyped-def]
    """Send robot v elsewhere, coverage and all."""
    old = plan.fuse[v]
    set_edges(plan, v, slam, fuse)
    if old == fuse:
        return
    for at in range(stages.first[v], stages.first[v + 1]):
        cell = stages.cells[at]
        plan.cover[old, cell] -= 1
        plan.covered[old] -= plan.cover[old, cell] == 0
        plan.covered[fuse] += plan.cover[fuse, cell] == 0
        plan.cover[fuse, cell] += 1


@njit(cache=True)
def cells_alone(stages, plan, v):  # type: ignore[no-untyped-def]
    """How many cells of its edge map only robot v covers."""
    count = 0
    for at in range(stages.first[v], stages.first[v + 1]):
        count += plan.cover[plan.fuse[v], stages.cells[at]] == 1
    return count


@njit(cache=True)
def cells_new(stages, plan, v, edge):  # type: ignore[no-untyped-def]
    """How many cells robot v would add to the map of another edge."""
    count = 0
    for at in range(stages.first[v], stages.first[v + 1]):
        count += plan.cover[edge, stages.cells[at]] == 0
    return count


@njit(cache=True)
def cells_swapped(stages, plan, mark, u, v):  # type: ignore[no-untyped-def]
    """How many cells v brings to u's edge map without u, and how many v's edge map loses with v that u does not have.

    `mark[cell] == u` for the cells of u.
    """
    brought = 0
    lost = 0
    for at in range(stages.first[v], stages.first[v + 1]):
        cell = stages.cells[at]
        shared = mark[cell] == u
        brought += plan.cover[plan.fuse[u], cell] - shared == 0
        lost += plan.cover[plan.fuse[v], cell] == 1 and not shared
    return brought, lost
