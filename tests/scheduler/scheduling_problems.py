"""Overlap graphs and problems for the tests of the scheduler."""

from __future__ import annotations

import numpy as np

from services.scheduler.costs import Problem
from services.scheduler.graph import quantise


def graph(kind: str, count: int, seed: int = 0) -> np.ndarray:
    """(count, count) overlap matrix: dense, sparse, edgeless, disconnected or ties (all weights equal)."""
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.uniform(0, 0.5, (count, count)), 1)
    if kind == "sparse":
        upper *= rng.random((count, count)) < 4 / max(count, 1)
    elif kind == "edgeless":
        upper[:] = 0
    elif kind == "disconnected":
        upper[: count // 2, count // 2 :] = 0
    elif kind == "ties":
        upper = np.triu(np.full((count, count), 0.25) * (rng.random((count, count)) < 0.5), 1)
    return quantise(np.rint((upper + upper.T) * 2**20) / 2**20)


def problem(
    robots: int, edges: int, *, seed: int = 0, spread: float = 4.0, reach: float = 1.0, placed=False
) -> Problem:
    """Robots with round footprints on a floor, edges whose speeds and links differ by up to `spread` times."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(0, 6 * np.sqrt(max(robots, 1)), (robots, 2))
    grid = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6), indexing="ij"), -1).reshape(-1, 2)
    disc = grid[(grid**2).sum(1) < 20]
    footprints = tuple(np.sort(((np.rint(p).astype(int) + disc + 1000) @ [4096, 1]).astype(np.int64)) for p in at)
    sizes = np.array([f.size for f in footprints])
    overlap = np.array([[np.intersect1d(a, b).size for b in footprints] for a in footprints], dtype=float)
    weights = overlap.reshape(robots, robots) / np.maximum(sizes[:, None] + sizes[None, :], 1)
    np.fill_diagonal(weights, 0)

    def uneven(*shape: int) -> np.ndarray:
        return np.exp(rng.uniform(-0.5, 0.5, shape) * np.log(spread))

    reachable = rng.random((robots, edges)) < reach
    reachable[np.arange(robots), rng.integers(0, edges, robots)] = True
    frame_bytes = rng.uniform(1e6, 3e6, robots)
    current = rng.integers(0, edges, robots) if placed else np.full(robots, -1)
    return Problem(
        robots=tuple(f"r{i}" for i in range(robots)),
        edges=tuple(f"e{i}" for i in range(edges)),
        weights=quantise(weights),
        footprints=footprints,
        reachable=reachable,
        robot_bandwidth=5e6 * uneven(robots, edges),
        edge_bandwidth=1e6 * uneven(edges),
        speed=uneven(edges),
        cores=np.full(edges, 4),
        frame_bytes=frame_bytes,
        slam_s=0.15e-6 * frame_bytes,
        pack_s=np.full(robots, 0.05),
        current_slam=current,
        current_fuse=current.copy(),
        move_cost=np.full(robots, 0.6),
    )
