"""Trajectory errors: a rigid motion is no error, one fit serves all robots, and numbers are those of the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import UsageError
from common.evaluation.trajectory import absolute_error, associate, fit, fit_all, relative_error
from common.geometry import apply, compose

coordinate = st.floats(-100, 100)
poses = st.tuples(coordinate, coordinate, st.floats(-3.1, 3.1))


def walk(seed: int, count: int = 60, start: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = np.cumsum(rng.normal(0, 0.2, count))
    steps = 0.3 * np.column_stack([np.cos(theta), np.sin(theta)])
    return np.column_stack([start + np.arange(count) * 0.1, np.cumsum(steps, axis=0), theta])


def moved(track: np.ndarray, pose) -> np.ndarray:
    return np.column_stack([track[:, 0], compose(pose, track[:, 1:])])


@given(poses, st.integers(0, 99))
def test_a_fit_finds_the_motion_between_two_sets_of_points(pose, seed):
    points = np.random.default_rng(seed).uniform(-20, 20, (30, 2))
    np.testing.assert_allclose(apply(fit(points, apply(pose, points)), points), apply(pose, points), atol=1e-9)


def test_no_other_motion_fits_noisy_points_better():
    rng = np.random.default_rng(1)
    points = rng.uniform(-5, 5, (50, 2))
    onto = apply((1, 2, 0.7), points) + rng.normal(0, 0.3, (50, 2))
    best = fit(points, onto)
    residual = ((apply(best, points) - onto) ** 2).sum()
    for change in rng.normal(0, 0.05, (200, 3)):
        assert ((apply(best + change, points) - onto) ** 2).sum() >= residual


@given(poses, st.integers(0, 20))
def test_a_rigidly_moved_trajectory_is_free_of_error(pose, seed):
    truth = walk(seed)
    stats = absolute_error([moved(truth, pose)], [truth])
    assert stats.n == 60
    assert stats.max == pytest.approx(0, abs=1e-9)
    assert stats.rotation_rmse == pytest.approx(0, abs=1e-9)
    assert relative_error(moved(truth, pose), truth).max == pytest.approx(0, abs=1e-9)


def test_one_fit_serves_all_robots_so_a_robot_placed_wrongly_shows():
    truths = [walk(1), walk(2)]
    apart = [moved(truths[0], (3, 0, 0)), moved(truths[1], (5, 0, 0))]
    assert absolute_error(apart, truths).mean == pytest.approx(1.0, abs=0.05)
    assert absolute_error(apart[:1], truths[:1]).mean == pytest.approx(0, abs=1e-9)
    assert absolute_error(apart, truths, align=False).mean == pytest.approx(4.0)
    pose, estimates, references = fit_all(apart, truths)
    assert pose.shape == (3,)
    assert [len(e) for e in estimates] == [len(t) for t in references] == [60, 60]


def test_the_numbers_are_those_of_the_textbook():
    truth = np.column_stack([np.arange(4.0), np.arange(4.0), np.zeros(4), np.zeros(4)])
    estimate = truth + np.array([[0, 0, 3, 0.1], [0, 0, 0, -0.1], [0, 0, 0, 0], [0, 4, 0, 0]])
    stats = absolute_error([estimate], [truth], max_gap=2, align=False)
    assert stats == pytest.approx((4, 2.5, 1.75, 4.0, np.sqrt(0.005), 0.05))


def test_drift_is_counted_per_stretch_of_way():
    truth = np.column_stack([np.arange(11.0), np.arange(11.0), np.zeros(11), np.zeros(11)])
    stretched = truth * [1, 1.02, 1, 1]
    stats = relative_error(stretched, truth, metres=5, max_gap=2)
    assert (stats.n, stats.mean) == (6, pytest.approx(0.1))
    assert relative_error(stretched, truth, metres=50, max_gap=2).n == 0


def test_poses_are_paired_by_stamp_and_only_where_the_truth_is_dense():
    truth = np.array([[0, 0, 0, 3.1], [1, 2, 0, -3.1], [5, 9, 9, 0]])
    estimate = np.array([[9, 0, 0, 0], [0.5, 0, 0, 0], [3, 0, 0, 0], [5, 1, 1, 1], [-1, 0, 0, 0]])
    ours, theirs = associate(estimate, truth, max_gap=1.0)
    np.testing.assert_array_equal(ours[:, 0], [0.5, 5])
    np.testing.assert_allclose(theirs[0, 1:3], [1, 0])
    assert abs(theirs[0, 3]) == pytest.approx(np.pi)
    np.testing.assert_allclose(theirs[1], [5, 9, 9, 0])


def test_foreign_clocks_are_refused():
    with pytest.raises(UsageError, match="one clock"):
        absolute_error([walk(1, start=1e9)], [walk(1)])
    with pytest.raises(UsageError, match="pairs"):
        fit([], [])
