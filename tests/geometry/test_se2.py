"""The group laws of planar poses, and tracks between their samples."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from common.geometry import IDENTITY, apply, between, compose, interpolate, inverse, wrap

coordinates = st.floats(-1e4, 1e4)
angles = st.floats(-50.0, 50.0)
poses = st.tuples(coordinates, coordinates, angles).map(np.array)


def same(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    gap = np.asarray(a) - np.asarray(b)
    return bool(np.abs(gap[..., :2]).max() < 1e-6 and np.abs(wrap(gap[..., 2])).max() < 1e-9)


@given(poses, poses, poses)
def test_composition_is_associative(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> None:
    assert same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses)
def test_a_pose_and_its_inverse_cancel_on_both_sides(a: NDArray[np.float64]) -> None:
    assert same(compose(a, inverse(a)), IDENTITY)
    assert same(compose(inverse(a), a), IDENTITY)


@given(poses, poses)
def test_between_undoes_composition(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    assert same(between(a, compose(a, b)), b)


@given(poses, poses, coordinates, coordinates)
def test_points_move_through_composed_poses_one_by_one(
    a: NDArray[np.float64], b: NDArray[np.float64], x: float, y: float
) -> None:
    points = np.array([[x, y], [0.0, 0.0]])
    assert np.allclose(apply(compose(a, b), points), apply(a, apply(b, points)), atol=1e-6)


@given(angles)
def test_wrapped_angles_lie_in_one_turn_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.isclose(np.cos(wrapped), np.cos(angle), atol=1e-9)
    assert np.isclose(np.sin(wrapped), np.sin(angle), atol=1e-9)


@given(poses, poses)
def test_batches_are_composed_row_by_row(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    batch = compose(np.stack([a, b]), np.stack([b, a]))
    assert same(batch, np.stack([compose(a, b), compose(b, a)]))


def test_interpolation_turns_the_short_way_round_and_holds_beyond_the_ends() -> None:
    stamps, track = np.array([0.0, 1.0]), np.array([[0.0, 0.0, 3.0], [2.0, 4.0, -3.0]])
    middle = interpolate(stamps, track, [0.5])[0]
    assert np.allclose(middle[:2], [1.0, 2.0])
    assert np.isclose(abs(middle[2]), np.pi, atol=1e-9)
    assert np.allclose(interpolate(stamps, track, [-5.0, 9.0]), track)
