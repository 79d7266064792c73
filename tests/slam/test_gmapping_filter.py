"""Promises of resampling, the tree of trajectories, the published map and the track between registered scans."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import between, compose
from services.edge_worker.slam.gmapping.particle_chart import ParticleChart
from services.edge_worker.slam.gmapping.particle_track import ParticleTrack, way_of
from services.edge_worker.slam.gmapping.particle_tree import Generation, ParticleTree
from services.edge_worker.slam.gmapping.resampling import effective, normalised, systematic
from services.edge_worker.slam.raycast import Canvas
from services.edge_worker.slam.scan import NO_POINTS

PARTICLES = 6


def grown(seed: int, generations: int) -> tuple[ParticleTree, list[Generation], np.random.Generator]:
    rng = np.random.default_rng(seed)
    tree, made = ParticleTree(), []
    for k in range(generations):
        parents = np.sort(rng.integers(0, PARTICLES, PARTICLES)) if k % 4 == 3 else np.arange(PARTICLES)
        points = rng.normal(0, 1, (20, 2)).astype(np.float32)
        made.append(Generation(rng.normal(0, 2, (PARTICLES, 3)), parents, points, NO_POINTS, np.zeros(2)))
        tree.append(made[-1])
    return tree, made, rng


def lineage(made: list[Generation], particle: int) -> np.ndarray:
    poses = []
    for generation in reversed(made):
        poses.append(generation.poses[particle])
        particle = int(generation.parents[particle])
    return np.array(poses[::-1])


@given(st.lists(st.floats(-50, 0), min_size=1, max_size=40), st.floats(0, 1, exclude_max=True))
def test_a_particle_of_weight_w_survives_floor_or_ceil_of_n_w_times(logs: list[float], draw: float) -> None:
    weights = normalised(np.array(logs), 0.1)
    assert weights.sum() == pytest.approx(1)
    assert 1 - 1e-9 <= effective(weights) <= len(logs) + 1e-9
    kept = np.bincount(systematic(weights, draw), minlength=len(logs))
    assert kept.sum() == len(logs)
    assert (np.abs(kept - weights * len(logs)) < 1 + 1e-9).all()


def test_smoothing_divides_the_logarithms() -> None:
    weights = normalised(np.array([0.0, -90.0]), 45.0)
    assert weights[1] / weights[0] == pytest.approx(np.exp(-1))


def test_settling_keeps_each_living_lineage() -> None:
    tree, made, _ = grown(1, 60)
    fixed = tree.settle()
    assert fixed
    assert len(tree.settled) == len(fixed)
    assert len(tree) == 60
    for particle in range(PARTICLES):
        assert np.array_equal(tree.lineage(particle), lineage(made, particle))
        row = len(tree.branches) // 2
        ancestor = tree.ancestors(row)[particle]
        assert np.array_equal(tree.branches[row].poses[ancestor], lineage(made, particle)[len(tree.settled) + row])


def test_only_ancestors_of_the_living_are_kept_however_often_the_tree_is_pruned() -> None:
    made = grown(4, 60)[1]
    often, once = ParticleTree(), ParticleTree()
    for k, generation in enumerate(made):
        often.append(generation)
        once.append(generation)
        if k % 7 == 3:
            often.settle()
    often.settle()
    once.settle()
    for tree in (often, once):
        assert all(len(np.unique(b.parents)) == len(a.poses) for a, b in pairwise(tree.branches))
        assert len(tree.branches[-1].poses) == PARTICLES
        for particle in range(PARTICLES):
            assert np.array_equal(tree.lineage(particle), lineage(made, particle))
    assert [len(g.poses) for g in often.branches] == [len(g.poses) for g in once.branches]


def test_the_map_is_the_same_however_often_the_best_particle_changed() -> None:
    tree, made, rng = ParticleTree(), grown(2, 30)[1], np.random.default_rng(3)
    chart = ParticleChart(0.05)
    for generation in made:
        tree.append(generation)
        if rng.random() < 0.7:
            chart.follow(tree, int(rng.integers(PARTICLES)))
        chart.settle(tree.settle())
    chart.follow(tree, 4)
    anew = Canvas(0.05)
    for pose, generation in zip(lineage(made, 4), made, strict=True):
        anew.draw(pose, generation.points, generation.laser)
    twin = ParticleChart(0.05)
    anew.publish(twin.grid)
    assert chart.grid.digest() == twin.grid.digest()


def test_a_map_that_moves_few_scans_a_time_moves_the_latest_and_arrives() -> None:
    tree, chart = ParticleTree(), ParticleChart(0.05)
    rng = np.random.default_rng(5)
    for _ in range(10):
        points = rng.normal(0, 1, (20, 2)).astype(np.float32)
        tree.append(Generation(rng.normal(0, 2, (PARTICLES, 3)), np.arange(PARTICLES), points, NO_POINTS, np.zeros(2)))
    chart.follow(tree, 0)
    moved = []
    for _ in range(4):
        chart.follow(tree, 1, most=3)
        moved.append((np.array(chart.drawn) == tree.branch(1)).all(axis=1).tolist())
    assert [sum(rows) for rows in moved] == [3, 6, 9, 10]
    assert moved[0] == [False] * 7 + [True] * 3
    twin = ParticleChart(0.05)
    twin.follow(tree, 1)
    assert chart.grid.digest() == twin.grid.digest()


def test_tiles_that_do_not_differ_keep_their_version() -> None:
    tree, chart = ParticleTree(), ParticleChart(0.05)
    for x in (0.0, 20.0):
        poses = np.zeros((PARTICLES, 3))
        poses[:, 0] = x
        poses[3, 1] = 0.5 if x else 0.0  # the fourth particle differs at the far scan only
        points = np.array([[0.4, 0.4], [0.5, 0.4]], np.float32)
        tree.append(Generation(poses, np.arange(PARTICLES), points, NO_POINTS, np.zeros(2)))
    chart.follow(tree, 0)
    first = chart.grid.version
    chart.follow(tree, 1)
    assert chart.grid.version == first
    chart.follow(tree, 3)
    assert {key[0] for key in chart.grid.delta(first)} == {20 * 20 // 64}


def test_frames_between_registered_scans_are_blended_without_a_jump() -> None:
    track, step = ParticleTrack(), np.array([0.05, 0.0, 0.02])
    since, way = np.zeros(3), 0.0
    track.append(0.0, 0, since, way)
    for k in range(1, 21):
        since, way = compose(since, step), way + way_of(step)
        if k % 10 == 0:
            track.close(since, way)
            since, way = np.zeros(3), 0.0
        track.append(float(k), k // 10, since, way)
    registered = np.array([[0.0, 0, 0], [0.56, 0.06, 0.22], [1.1, 0.25, 0.4]])
    rows = track.poses(registered)
    assert np.array_equal(rows[:, 0], np.arange(21))
    np.testing.assert_allclose(rows[[0, 10, 20], 1:], registered, atol=1e-12)
    steps = between(rows[:-1, 1:], rows[1:, 1:])
    assert np.abs(steps - step).max() < 0.012
