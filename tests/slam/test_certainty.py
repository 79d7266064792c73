"""What a scan seems to know of its pose and what may be believed of it."""

import numpy as np
import pytest

from common.geometry import apply, between, compose
from services.edge_worker.slam.graph.certainty import alone, believed, carried, owed
from services.edge_worker.slam.graph.icp import align
from services.edge_worker.slam.graph.surfels import SurfelMap

ORIGIN = np.zeros(3)


def test_what_is_not_trusted_is_left_to_the_prior() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(0, 1, (3, 3))
    seeming, weights = rows.T @ rows + np.eye(3), np.array([4.0, 4.0, 9.0])
    trusted = np.diag([0.0, 0.3, 0.5]) @ seeming @ np.diag([0.0, 0.3, 0.5])
    scan, prior = rng.normal(0, 1, 3), rng.normal(0, 1, 3)

    def best(information: np.ndarray) -> np.ndarray:
        return np.linalg.solve(information + np.diag(weights), information @ scan + weights * prior)

    found = best(seeming)
    assert found + owed(seeming, trusted, weights, prior - found) == pytest.approx(best(trusted))
    assert owed(seeming, seeming, weights, prior - found) == pytest.approx(ORIGIN)


@pytest.mark.parametrize("away_m", [0.5, 3.0, 10.0])
@pytest.mark.parametrize("scatter", [0.003, 0.03])
def test_a_heading_is_known_by_the_length_of_a_wall_however_far_ahead_it_stands(away_m: float, scatter: float) -> None:
    """A wall of 0.6 m beside the way, whose place is known, but the robot's only as far as its heading is."""
    rng = np.random.default_rng(0)
    along = np.tile(np.arange(-0.3, 0.3, 0.02), 10)
    astray = rng.normal(0.0, scatter**0.5, len(along))
    x, y = away_m + along, 1.5
    normals = np.sin(astray), -np.cos(astray)
    rows = np.stack([*normals, x * normals[1] - y * normals[0]], axis=1) / 0.02
    trusted = believed(rows.T @ rows, scatter)
    expected = 0.02**2 / np.square(along).sum()
    assert alone(trusted)[2, 2] == pytest.approx(expected, rel=0.4)
    at_wall = carried(trusted, np.array([away_m, y, 0.0]))
    assert np.linalg.inv(at_wall + 1e-6 * np.eye(3))[1, 1] < 3 * 0.02**2 / len(along)
    assert np.linalg.inv(trusted + 1e-4 * np.eye(3))[0, 0] > 0.1**2


@pytest.mark.parametrize("seed", range(4))
def test_a_search_that_slid_along_a_corridor_does_not_move_the_robot(seed: int) -> None:
    """Walls are rough, so that each place along them seems to hold a scan a little."""
    rng = np.random.default_rng(seed)

    def walls(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        x = np.tile(np.arange(low, high, 0.04), 2)
        side = np.repeat([-1.0, 1.0], len(x) // 2)
        astray = rng.normal(0.0, 0.05, len(x))
        points = np.stack([x, side + rng.normal(0.0, 0.01, len(x))], axis=1)
        return points.astype(np.float32), np.stack([np.sin(astray), -side * np.cos(astray)], 1).astype(np.float32)

    corridor = SurfelMap(512)
    corridor.insert(*walls(-8.0, 8.0), ORIGIN)
    points, facing = walls(-4.0, 4.0)
    slid, told = np.array([0.15, 0.0, 0.0]), ORIGIN
    found = align(corridor, points, facing, slid, told, (0.1, 0.05))
    assert np.abs(between(told, found.pose)[:2]) == pytest.approx([0.0, 0.0], abs=0.02)
    assert np.abs(apply(found.pose, points)[:, 1]) == pytest.approx(np.ones(len(points)), abs=0.06)


def test_what_is_known_of_a_pose_is_known_of_what_lies_fast_to_it() -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(0, 1, (3, 3))
    information, pose, step = rows.T @ rows, np.array([2.0, -1.0, 0.8]), 1e-6 * rng.normal(0, 1, 3)
    there = carried(information, pose)
    back = compose(compose(pose, step), between(pose, ORIGIN))
    assert step @ there @ step == pytest.approx(back @ information @ back, rel=1e-4)
