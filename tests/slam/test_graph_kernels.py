"""The compiled kernels of graph SLAM against plain numpy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from common.geometry import apply, between, compose
from common.geometry.pose_graph import PoseGraph, linearise, squared_errors
from services.edge_worker.slam.graph.branch_and_bound import COARSE, LEVELS, pyramid, search
from services.edge_worker.slam.graph.certainty import believed
from services.edge_worker.slam.graph.correlate import STEP, correlate
from services.edge_worker.slam.graph.holders import move
from services.edge_worker.slam.graph.icp import align
from services.edge_worker.slam.graph.keyframe import normals, thin
from services.edge_worker.slam.graph.submap import evidence, overlay, within
from services.edge_worker.slam.graph.surfels import CELL, FINE, SPLAT, SurfelMap, nearest

LASER = np.zeros(2)
ORIGIN = np.zeros(3)
SIZE = 256


def room(pose: NDArray[np.float64], beams: int = 360) -> NDArray[np.float32]:
    """Points (n, 2) that a laser at `pose` sees of an L-shaped room around the origin."""
    angles = 2 * np.pi * np.arange(beams) / beams
    walls = np.array([(-3, -2), (4, -2), (4, 1), (1, 1), (1, 3), (-3, 3), (-3, -2)], float)
    rays = np.stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])], axis=1)
    best = np.full(beams, np.inf)
    for a, b in pairwise(walls):
        edge, start = b - a, a - pose[:2]
        cross = rays[:, 0] * edge[1] - rays[:, 1] * edge[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (start[0] * edge[1] - start[1] * edge[0]) / cross
            u = (start[0] * rays[:, 1] - start[1] * rays[:, 0]) / cross
        best = np.where((t > 0) & (u >= 0) & (u <= 1) & (t < best), t, best)
    return (best[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float32)


def facing(points: NDArray[np.float32]) -> NDArray[np.float32]:
    return normals(points, np.arange(len(points), dtype=np.int32), LASER)


@pytest.fixture(scope="module")
def surfels() -> SurfelMap:
    made = SurfelMap(SIZE)
    for pose in ([0.0, 0.0, 0.0], [0.4, 0.2, 0.5], [-0.5, 0.3, -0.3]):
        points = room(np.array(pose))
        made.insert(points, facing(points), np.array(pose))
    return made


def test_normals_stand_on_walls_and_face_the_laser() -> None:
    points = room(ORIGIN)
    found = facing(points)
    plain = np.zeros_like(points)
    for i in range(2, len(points) - 2):
        five = points[i - 2 : i + 3].astype(float)
        gaps = np.hypot(*np.diff(five, axis=0).T)
        if (gaps > 0.06).any():
            continue
        values, vectors = np.linalg.eigh(np.cov(five.T, bias=True))
        if np.sqrt(max(values[0], 0)) < 0.02:
            plain[i] = vectors[:, 0] * (1 if vectors[:, 0] @ -five[2] > 0 else -1)
    chosen = (plain != 0).any(axis=1)
    assert chosen.sum() > 150
    assert np.abs(found[chosen] - plain[chosen]).max() < 1e-3
    assert np.allclose(np.hypot(*found[(found != 0).any(axis=1)].T), 1, atol=1e-6)


def test_thinning_keeps_points_apart_and_no_more_than_asked() -> None:
    points = room(ORIGIN)
    kept = thin(points, facing(points), LASER, 0.2, 1000)
    steps = np.hypot(*np.diff(points[kept], axis=0).T)
    assert 0.15 < np.median(steps) < 0.25
    assert len(thin(points, facing(points), LASER, 0.0, 50)) == 50
    near = np.hypot(*points.T) < 2.2
    assert np.isin(np.flatnonzero(~near), kept).mean() > np.isin(np.flatnonzero(near), kept).mean()


def test_thinning_turns_no_scan() -> None:
    """Taking the first point that is far enough from the last takes those that err away from it: a turn of 1 mrad."""
    rng, angles = np.random.default_rng(1), np.radians(np.arange(-180, 180))
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    turns = []
    for _ in range(400):
        ranges = 1.2 / np.maximum(np.abs(rays[:, 1]), 0.12) + rng.normal(scale=0.03, size=360)
        points = (ranges[:, None] * rays).astype(np.float32)[np.abs(rays[:, 1]) > 0.15]
        kept = thin(points, facing(points), LASER, 0.05, 1000)
        x, off = points[kept, 0], points[kept, 1] - np.copysign(1.2, points[kept, 1])
        turns.append(float(x @ off / (x @ x)))
    assert abs(np.mean(turns)) < 3 * np.std(turns) / np.sqrt(len(turns))


def test_surfels_hold_the_sums_of_their_points_and_the_field_their_likelihood() -> None:
    made, pose, points = SurfelMap(SIZE), np.array([0.3, -0.2, 0.7]), room(ORIGIN)
    directions = facing(points)
    made.insert(points, directions, pose)
    placed = apply(pose, points)
    chosen = (directions != 0).any(axis=1)
    assert made.sums[: made.count, 0].sum() == chosen.sum()
    assert np.allclose(made.sums[: made.count, 1:3].sum(axis=0), placed[chosen].sum(axis=0))
    field = np.zeros_like(made.field)
    reach = len(SPLAT) // 2
    for i, j in np.floor(placed / FINE).astype(int):
        rows, columns = np.ix_(
            np.arange(j - reach, j + reach + 1) % len(field), np.arange(i - reach, i + reach + 1) % len(field)
        )
        field[rows, columns] = np.maximum(field[rows, columns], SPLAT)
    assert np.array_equal(made.field, field)
    made.clear()
    assert not made.field.any()
    assert (made.index == -1).all()


def test_the_nearest_surfel_is_the_nearest_of_all_around_that_face_alike(surfels: SurfelMap) -> None:
    rng = np.random.default_rng(1)
    sums = surfels.sums[: surfels.count]
    means, directions = sums[:, 1:3] / sums[:, :1], sums[:, 3:] / np.hypot(sums[:, 3], sums[:, 4])[:, None]
    for _ in range(200):
        x, y = means[rng.integers(len(means))] + rng.normal(0, 0.05, 2)
        angle = rng.uniform(-np.pi, np.pi)
        nx, ny = np.cos(angle), np.sin(angle)
        around = np.abs(np.floor(means / CELL) - np.floor(np.array([x, y]) / CELL)).max(axis=1) <= 1
        alike = around & (directions @ [nx, ny] > 0.5)
        found = nearest(surfels.index, surfels.sums, surfels.chain, x, y, nx, ny)
        if not alike.any():
            assert found == -1
        else:
            off = np.hypot(*(means - [x, y]).T)
            assert off[found] == pytest.approx(off[alike].min())


@pytest.mark.parametrize("seed", range(4))
def test_alignment_finds_the_pose_and_says_how_well_it_is_known(surfels: SurfelMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform([-0.6, -0.4, -0.8], [0.6, 0.4, 0.8])
    points = room(truth)
    start = compose(truth, rng.uniform(-1, 1, 3) * [0.05, 0.05, 0.02])
    found = align(surfels, points, facing(points), start, start, (1.0, 1.0))
    assert np.abs(between(truth, found.pose)).max() < 0.005
    assert found.inliers > 0.9
    assert np.linalg.eigvalsh(found.information).min() > 1e3


def test_alignment_along_a_corridor_keeps_to_the_prior_and_knows_that_it_does_not_know() -> None:
    made = SurfelMap(SIZE)
    x = np.linspace(-5, 5, 400)
    walls = np.concatenate([np.stack([x, np.full(400, 1.0)], 1), np.stack([x, np.full(400, -1.0)], 1)]).astype(
        np.float32
    )
    directions = np.concatenate([np.tile([0, -1], (400, 1)), np.tile([0, 1], (400, 1))]).astype(np.float32)
    made.insert(walls, directions, ORIGIN)
    near = np.abs(walls[:, 0]) < 3
    prior = np.array([0.2, 0.03, 0.01])
    found = align(made, walls[near], directions[near], prior, prior, (0.05, 0.05))
    assert found.pose == pytest.approx([0.2, 0.0, 0.0], abs=0.005)
    assert found.information[0, 0] < 1e-3 * found.information[1, 1]


def test_scattered_normals_do_not_hold_a_pose_along_a_corridor() -> None:
    rng = np.random.default_rng(5)
    x, side = rng.uniform(-5, 5, 400), rng.choice([-1.0, 1.0], 400)
    astray = rng.normal(0.0, 0.15, 400)
    across, along = side * np.cos(astray), side * np.sin(astray)
    rows = np.stack([along, across, across * x - along * side], axis=1) / 0.02
    claimed = rows.T @ rows
    kept = believed(claimed, 0.03)
    assert claimed[0, 0] ** -0.5 < 0.01
    assert kept[0, 0] < 0.01 * claimed[0, 0]
    assert kept[1, 1] > 0.9 * claimed[1, 1]
    assert np.linalg.eigvalsh(kept).min() > -1e-6 * np.trace(kept)


def test_a_room_holds_a_pose_all_the_same(surfels: SurfelMap) -> None:
    points = room(ORIGIN)
    found = align(surfels, points, facing(points), ORIGIN, ORIGIN, (1.0, 1.0))
    assert np.linalg.inv(found.information)[:2, :2].diagonal().max() < 0.01**2


def test_correlation_finds_the_best_pose_of_its_lattice(surfels: SurfelMap) -> None:
    points = room(np.array([0.2, -0.1, 0.3]))[::5]
    guess, reach, turn, step = np.array([0.05, 0.0, 0.25]), 0.3, 0.1, 0.05
    best = (-1.0, ORIGIN)
    mask = len(surfels.field) - 1
    for a in range(-2, 3):
        base = np.array([guess[0], guess[1], guess[2] + a * step])
        i, j = np.floor(apply(base, points) / FINE).astype(int).T
        for dj in range(-3, 4):
            for di in range(-3, 4):
                mean = surfels.field[(j + STEP * dj) & mask, (i + STEP * di) & mask].mean() / 255
                score = mean * (1 - 0.08 * ((di**2 + dj**2) / 9 + a**2 / 4))
                best = max(
                    best, (score, (base[0] + STEP * FINE * di, base[1] + STEP * FINE * dj, base[2])), key=lambda b: b[0]
                )
    pose, score = correlate(surfels.field, points, guess, reach, turn, step)
    assert score == pytest.approx(best[0])
    assert pose == pytest.approx(best[1])


def test_pyramid_levels_bound_all_that_is_below_them(surfels: SurfelMap) -> None:
    levels = pyramid(surfels.field)
    base = surfels.field.reshape(SIZE, 2, SIZE, 2).max(axis=(1, 3))
    assert np.array_equal(levels[0], base)
    for level in range(1, LEVELS):
        span = range(1 << level)
        assert np.array_equal(
            levels[level], np.max([np.roll(base, (-j, -i), (0, 1)) for j in span for i in span], axis=0)
        )


def test_branch_and_bound_finds_what_looking_everywhere_finds(surfels: SurfelMap) -> None:
    levels, mask = pyramid(surfels.field), SIZE - 1
    points = room(np.array([0.2, -0.1, 0.3]))[::8]
    guess, reach, turn, step = np.array([-0.8, 0.7, 0.2]), 1.6, 0.2, 0.05
    best = 0.0
    for a in range(-4, 5):
        i, j = np.floor(apply([guess[0], guess[1], guess[2] + a * step], points) / COARSE).astype(int).T
        for dj in range(-16, 17):
            for di in range(-16, 17):
                best = max(best, levels[0][(j + dj) & mask, (i + di) & mask].mean() / 255)
    found, score = search(levels, points, guess, reach, turn, step, 0.1, np.zeros(2), 0.0)
    assert score == pytest.approx(best)
    assert np.abs(between(found, [0.2, -0.1, 0.3])).max() < 0.15
    elsewhere, rival = search(levels, points, guess, reach, turn, step, 0.1, found[:2], 0.6)
    assert rival < score
    assert np.hypot(*(elsewhere - found)[:2]) >= 0.6


def test_evidence_tells_walls_from_space_seen_empty() -> None:
    seen, patch = np.zeros((64, 64), np.uint8), np.ones((10, 10), np.uint8)
    patch[:, 9] = 2
    overlay(seen, patch, -3, 5)
    points = np.array([[0.65, 0.75], [0.65, 1.25], [0.05, 0.95], [-0.25, 1.05], [3.0, 3.0]], np.float32)
    assert evidence(seen, points, ORIGIN) == (2, 2)
    assert within(points, ORIGIN, 1.0).tolist() == [True, False, True, False, False]


def test_moving_points_is_applying_a_pose() -> None:
    pose, points = np.array([1.0, -2.0, 0.7]), room(ORIGIN)
    assert np.allclose(move(points, pose), apply(pose, points), atol=1e-5)


def ring(count: int, rng: np.random.Generator) -> tuple[PoseGraph, NDArray[np.float64]]:
    """A graph of a round trip with drifting odometry and true loops, and the true poses."""
    turns = 2 * np.pi * np.arange(count) / count
    truth = np.stack([5 * np.sin(turns), 5 - 5 * np.cos(turns), turns], axis=1)
    graph = PoseGraph()
    graph.add_node(truth[0])
    for k in range(1, count):
        step = between(truth[k - 1], truth[k]) + rng.normal(0, [0.01, 0.01, 0.005]) + [0.004, 0, 0.002]
        graph.add_node(compose(graph.poses[-1], step))
        graph.add_edge(k - 1, k, step, np.diag([1e4, 1e4, 4e4]), loop=False)
    for i, j in ((0, count - 1), (2, count - 3), (5, count // 2)):
        graph.add_edge(i, j, between(truth[i], truth[j]), np.diag([1e4, 1e4, 1e5]), loop=True)
    return graph, truth


def test_the_gradient_and_the_hessian_are_those_of_the_squared_errors() -> None:
    graph, _ = ring(12, np.random.default_rng(0))
    limit = np.inf
    blocks, gradient = linearise(graph.poses, graph.pairs, graph.measured, graph.information, graph.loops, limit)
    numeric = np.zeros_like(gradient)
    for k in np.ndindex(*gradient.shape):
        ends = []
        for sign in (1, -1):
            poses = graph.poses.copy()
            poses[k] += sign * 1e-6
            ends.append(squared_errors(poses, graph.pairs, graph.measured, graph.information).sum() / 2)
        numeric[k] = (ends[0] - ends[1]) / 2e-6
    assert gradient == pytest.approx(numeric, rel=1e-4, abs=1e-2)
    assert np.allclose(blocks[:, 1], blocks[:, 2].transpose(0, 2, 1))


def test_optimising_mends_a_drifting_ring_and_holds_the_first_pose() -> None:
    graph, truth = ring(60, np.random.default_rng(1))
    before = np.hypot(*(graph.poses - truth)[:, :2].T).max()
    first = graph.poses[0].copy()
    graph.optimise(10, fresh=3)
    assert np.hypot(*(graph.poses - truth)[:, :2].T).max() < 0.25 * before
    assert np.array_equal(graph.poses[0], first)


def test_a_wrong_loop_is_outvoted() -> None:
    graph, _ = ring(60, np.random.default_rng(2))
    graph.optimise(10, fresh=3)
    good = graph.poses.copy()
    graph.add_edge(10, 40, np.array([3.0, 3.0, 1.0]), np.diag([1e4, 1e4, 1e5]), loop=True)
    graph.optimise(10, fresh=1)
    assert np.hypot(*(graph.poses - good)[:, :2].T).max() < 0.05
