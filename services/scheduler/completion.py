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
    crowd: Floats
    """(E,) by how much an edge's load and speed stretch SLAM"""
    linked: Ints
    """(E, E) robots by SLAM edge and fusing edge"""
    member: Ints
    """(E, V) the robots that edge e fuses are member[e, :maps[e]]"""
    place: Ints
    """(V,) where a robot stands there"""


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
    edges, robots = stages.speed.size, stages.slam.size
    cover = np.zeros((edges, int(stages.cells.max(initial=-1)) + 1), dtype=np.int32)
    np.add.at(cover, (np.repeat(fuse, np.diff(stages.first)), stages.cells), 1)
    running = np.bincount(slam, minlength=edges).astype(np.int64)
    maps = np.bincount(fuse, minlength=edges).astype(np.int64)
    linked = np.zeros((edges, edges), dtype=np.int64)
    np.add.at(linked, (slam, fuse), 1)
    order = np.argsort(fuse, kind="stable")
    place = np.empty(robots, dtype=np.int64)
    place[order] = np.arange(robots) - np.repeat(np.cumsum(maps) - maps, maps)
    member = np.full((edges, robots), -1, dtype=np.int64)
    member[fuse, place] = np.arange(robots)
    return Plan(
        slam=np.array(slam, dtype=np.int64),
        fuse=np.array(fuse, dtype=np.int64),
        running=running,
        maps=maps,
        covered=(cover > 0).sum(axis=1).astype(np.int64),
        cover=cover,
        crowd=np.maximum(1.0, running / stages.cores) / stages.speed,
        linked=linked,
        member=member,
        place=place,
    )


@njit(cache=True)
def ready(stages, plan, v):  # type: ignore[no-untyped-def]
    """When robot v's map is at the edge that fuses it."""
    at = plan.slam[v]
    to = plan.fuse[v]
    done = stages.base[v, at] + stages.slam[v] * plan.crowd[at]
    return done if at == to else done + stages.carried[v] * stages.lag[at, to] * stages.fetched[v, to]


@njit(cache=True)
def arrival(stages, plan, edge):  # type: ignore[no-untyped-def]
    """When this edge's map is at the cloud; 0 when it fuses nothing."""
    k = plan.maps[edge]
    if k == 0:
        return 0.0
    slams, crowd, member, base, work = plan.slam, plan.crowd, plan.member, stages.base, stages.slam
    last = 0.0
    for place in range(k):  # as `ready`, without its calls
        v = member[edge, place]
        at = slams[v]
        done = base[v, at] + work[v] * crowd[at]
        if at != edge:
            done += stages.carried[v] * stages.lag[at, edge] * stages.fetched[v, edge]
        last = max(last, done)
    area = plan.covered[edge] * stages.cell_m2
    fuse = stages.fusion[0] * k + stages.fusion[1] * k * (k - 1) / 2 + stages.fusion[2] * area
    return last + fuse / stages.speed[edge] + area * stages.upload[edge]


@njit(cache=True)
def evaluate(stages, plan, arrivals):  # type: ignore[no-untyped-def]
    """(t_c, score); fills `arrivals` (E,). The search lowers the score."""
    used = 0
    latest = 0.0
    total = 0.0
    for edge in range(arrivals.size):
        time = arrival(stages, plan, edge)
        arrivals[edge] = time
        used += time > 0.0
        total += time
        latest = max(latest, time)
    finish = latest + stages.merge[used]
    return finish, finish + EVENNESS * total / max(used, 1)


@njit(cache=True)
def set_edges(stages, plan, v, slam, fuse):  # type: ignore[no-untyped-def]
    """Send robot v elsewhere; the coverage is left to the caller."""
    a, b = plan.slam[v], plan.fuse[v]
    plan.linked[a, b] -= 1
    plan.linked[slam, fuse] += 1
    if a != slam:
        plan.running[a] -= 1
        plan.running[slam] += 1
        plan.crowd[a] = max(1.0, plan.running[a] / stages.cores[a]) / stages.speed[a]
        plan.crowd[slam] = max(1.0, plan.running[slam] / stages.cores[slam]) / stages.speed[slam]
    if b != fuse:
        plan.maps[b] -= 1
        last = plan.member[b, plan.maps[b]]
        plan.member[b, plan.place[v]] = last
        plan.place[last] = plan.place[v]
        plan.member[fuse, plan.maps[fuse]] = v
        plan.place[v] = plan.maps[fuse]
        plan.maps[fuse] += 1
    plan.slam[v] = slam
    plan.fuse[v] = fuse


@njit(cache=True)
def relocate(stages, plan, v, slam, fuse):  # type: ignore[no-untyped-def]
    """Send robot v elsewhere, coverage and all."""
    old = plan.fuse[v]
    set_edges(stages, plan, v, slam, fuse)
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
