"""Graphs and problems that the scheduler's bench runs on.

Families: `dense` (uniform weights on every pair), `random` (Erdős-Rényi of mean degree 6), `floor` (robots drive
through the rooms of one floor, footprints by ray casting) and `floors` (2-8 floors, some rooms visited much more).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.scheduler.costs import FusionModel, Problem
from services.scheduler.graph import quantise
from services.scheduler.overlap import Footprint, cells_of_points, lattice_cells, overlap_matrix

FAMILIES = ("dense", "random", "floor", "floors")
ROOM = 24  # fine cells of 0.25 m: rooms of 6 m
FINE_M = 0.25


def graph(family: str, robots: int, seed: int) -> NDArray[np.float64]:
    """(robots, robots) overlap matrix of this family."""
    rng = np.random.default_rng(seed)
    if family in ("dense", "random"):
        upper = np.triu(rng.uniform(0, 1, (robots, robots)), 1)
        if family == "random":
            upper *= np.triu(rng.random((robots, robots)) < 6 / max(robots - 1, 1), 1)
        return quantise(upper + upper.T)
    return overlap_matrix(footprints(family, robots, rng)).weights


def footprints(family: str, robots: int, rng: np.random.Generator) -> list[Footprint]:
    """What the robots of a building see on their ways."""
    count = 1 if family == "floor" else int(rng.integers(2, 9))
    side = max(2, int(np.ceil(np.sqrt(robots / count))))
    plans = [_floor(side, rng) for _ in range(count)]
    heat = np.ones(side * side) if family == "floor" else rng.pareto(1.2, side * side) + 0.2
    seen = []
    for robot in range(robots):
        level = int(rng.integers(count))
        room = int(rng.choice(side * side, p=heat / heat.sum()))
        way = _route(side, room, int(rng.integers(1, 5)), rng)
        points = _look(plans[level], way, float(rng.uniform(3.5, 6.0)) / FINE_M)
        cells = cells_of_points(points * FINE_M + [level * 1000.0 * side, 0.0])
        seen.append(Footprint(f"r{robot}", "building", cells))
    return seen


def _floor(side: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(side ROOM + 1)² raster of walls with a door of 1 m between neighbouring rooms."""
    size = side * ROOM + 1
    walls = np.zeros((size, size), dtype=bool)
    walls[::ROOM, :] = walls[:, ::ROOM] = True
    for line in range(1, side):
        for room in range(side):
            door = room * ROOM + int(rng.integers(3, ROOM - 6))
            walls[line * ROOM, door : door + 4] = False
            door = room * ROOM + int(rng.integers(3, ROOM - 6))
            walls[door : door + 4, line * ROOM] = False
    return walls


def _route(side: int, room: int, rooms: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(n, 2) places in fine cells: three in each room on a walk through neighbouring rooms."""
    x, y = divmod(room, side)
    places = []
    for _ in range(rooms):
        places.append(np.array([x, y]) * ROOM + rng.uniform(3, ROOM - 3, (3, 2)))
        step = [(1, 0), (-1, 0), (0, 1), (0, -1)][int(rng.integers(4))]
        x, y = int(np.clip(x + step[0], 0, side - 1)), int(np.clip(y + step[1], 0, side - 1))
    return np.concatenate(places)


@njit(cache=True)
def _look(walls, way, reach):  # type: ignore[no-untyped-def]
    """(n, 2) points in fine cells along 120 rays from each place, up to the first wall."""
    points = [(way[0, 0], way[0, 1])]
    for place in range(way.shape[0]):
        for ray in range(120):
            dx = np.cos(ray * np.pi / 60)
            dy = np.sin(ray * np.pi / 60)
            for step in range(int(reach)):
                x = way[place, 0] + dx * step
                y = way[place, 1] + dy * step
                if x < 0 or y < 0 or x >= walls.shape[0] or y >= walls.shape[1] or walls[int(x), int(y)]:
                    break
                points.append((x, y))
    return np.array(points)


@lru_cache(maxsize=128)
def _floor_seen(
    family: str, robots: int, seed: int
) -> tuple[list[Footprint], NDArray[np.float64], tuple[Any, ...], Any]:
    """Footprints, their overlaps and cells, and where the random numbers go on: alike for all edges and links."""
    rng = np.random.default_rng(seed)
    seen = footprints(family, robots, rng)
    return seen, overlap_matrix(seen).weights, lattice_cells(seen), rng.bit_generator.state


REGIMES = {"compute": 4e6, "balanced": 1e6, "network": 0.4e6}
"""bytes/s from an edge to the cloud"""


def problem(
    family: str, robots: int, edges: int, seed: int, *, speeds: float, links: float, regime: str = "balanced"
) -> Problem:
    """Edges whose speed differs by up to `speeds` times and whose links by up to `links` times, log-uniformly."""
    rng = np.random.default_rng(seed)
    seen, weights, cells, rng.bit_generator.state = _floor_seen(family, robots, seed)

    def uneven(spread: float, *shape: int) -> NDArray[np.float64]:
        return np.asarray(np.exp(rng.uniform(-0.5, 0.5, shape) * np.log(spread)))

    frame_bytes = rng.uniform(1e6, 3e6, robots)
    return Problem(
        robots=tuple(each.robot for each in seen),
        edges=tuple(f"e{index}" for index in range(edges)),
        weights=weights,
        footprints=cells,
        reachable=np.ones((robots, edges), dtype=bool),
        robot_bandwidth=5e6 * uneven(links, robots, edges),
        edge_bandwidth=REGIMES[regime] * uneven(links, edges),
        speed=uneven(speeds, edges),
        cores=np.full(edges, 4),
        frame_bytes=frame_bytes,
        slam_s=0.15e-6 * frame_bytes,
        pack_s=np.full(robots, 0.05),
        current_slam=np.full(robots, -1),
        current_fuse=np.full(robots, -1),
        move_cost=3 * frame_bytes / 5e6,
        fusion=FusionModel(),
    )
