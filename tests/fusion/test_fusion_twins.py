"""Compiled kernels agree with plain numpy, written from their definitions."""

import cv2
import numpy as np
import pytest
from drawn_worlds import apartment, mapped

from common.fusion.evidence import AGREES, CONTRADICTS, NEITHER, OUTSIDE, classify, longest_blob
from common.fusion.features import RATIO, _matches, fit_rigid
from common.fusion.matchmap import REACH_M, MatchMap
from common.fusion.refine import refine
from common.fusion.settings import FusionSettings
from common.fusion.walls import FAR_M, STRAIGHT
from common.geometry import apply, between, compose

HOME, AWAY = np.array([3.0, 2.0, 0.3]), np.array([-4.0, 7.0, 2.0])


@pytest.fixture(scope="module")
def pair() -> tuple[MatchMap, MatchMap, np.ndarray]:
    world = apartment(2)
    return mapped(world, HOME, (0, 11)), mapped(world, AWAY, (5, 16), seed=2), between(HOME, AWAY)


def test_the_nearest_wall_is_the_nearest_wall(pair) -> None:
    a = pair[0]
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, a.occupancy.shape, (300, 2)):
        gaps = np.linalg.norm(a.walls.cells - (row, column), axis=1) * a.resolution
        if gaps.min() <= REACH_M:
            assert a.nearest.distance[row, column] == pytest.approx(gaps.min(), abs=1e-5)
            assert gaps[a.nearest.wall[row, column]] == pytest.approx(gaps.min(), abs=1e-9)
        else:
            assert a.nearest.distance[row, column] == FAR_M


def test_matches_are_those_well_below_the_second_best_in_either_direction() -> None:
    rng = np.random.default_rng(5)
    a = rng.integers(0, 256, (40, 32), dtype=np.uint8)
    b = np.concatenate([a[::-2] ^ rng.integers(0, 2, (20, 32), dtype=np.uint8), a[:9], a[:5]])
    bits = np.unpackbits(a[:, None] ^ b[None], axis=2).sum(axis=2)
    expected = set()
    for distances, turned in ((bits, False), (bits.T, True)):
        for k, row in enumerate(distances):
            best, second = np.sort(row)[:2]
            if best < RATIO * second:
                j = int(row.argmin())
                expected.add((j, k) if turned else (k, j))
    assert len(expected) > 10
    assert [tuple(pair) for pair in _matches(a, b)] == sorted(expected)


def test_wall_lines_are_principal_axes_of_the_wall_around(pair) -> None:
    a = pair[0]
    for k in np.random.default_rng(1).integers(0, len(a.walls.cells), 100):
        gaps = a.walls.cells - a.walls.cells[k]
        near = gaps[(gaps**2).sum(axis=1) <= 36][:, ::-1].astype(float)
        values, axes = np.linalg.eigh(np.cov(near.T, bias=True))
        straight = (values[1] - values[0]) / values.sum()
        assert a.walls.straightness[k] == pytest.approx(straight, abs=1e-9)
        if straight > 0.1:
            assert abs(axes[:, 0] @ a.walls.normals[k]) == pytest.approx(1, abs=1e-9)


def test_normals_point_to_where_it_is_free(pair) -> None:
    a = pair[0]
    for k in np.random.default_rng(1).integers(0, len(a.walls.cells), 100):
        if a.walls.sided[k] and a.walls.straightness[k] > 0.8:
            rows, columns = np.nonzero(a.occupancy == 0)
            gaps = np.stack([columns, rows], axis=1) - a.walls.cells[k, ::-1]
            near = gaps[(np.abs(gaps) <= 6).all(axis=1)]
            assert ((near @ a.walls.normals[k]) > 0).mean() > 0.5


def plain_labels(target: MatchMap, walls, pose: np.ndarray, settings: FusionSettings) -> np.ndarray:
    """`classify` from its definition."""
    labels = np.full(len(walls.points), OUTSIDE)
    points = apply(pose, walls.points)
    normals = apply((0, 0, pose[2]), walls.normals)
    eroded = cv2.erode((target.occupancy == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    for k, (column, row) in enumerate(np.floor((points - target.origin) / target.resolution).astype(int)):
        if not (0 < row < target.occupancy.shape[0] - 1 and 0 < column < target.occupancy.shape[1] - 1):
            continue
        gap, wall = target.nearest.distance[row, column], target.nearest.wall[row, column]
        if gap <= settings.tolerance_m:
            cosine = normals[k] @ target.walls.normals[wall]
            if min(walls.straightness[k], target.walls.straightness[wall]) >= STRAIGHT:
                cosine = cosine if walls.sided[k] and target.walls.sided[wall] else abs(cosine)
                labels[k] = AGREES if cosine > 0.7 else NEITHER
            else:
                labels[k] = AGREES
        elif target.occupancy[row, column] != -1:
            labels[k] = CONTRADICTS if gap > settings.contradiction_m and eroded[row, column] else NEITHER
    return labels


@pytest.mark.parametrize("error", [(0, 0, 0), (0.3, -0.2, 0.1), (4, 1, 2)])
def test_walls_are_classified_by_their_definition(pair, error) -> None:
    a, b, truth = pair
    pose = compose(truth, error)
    labels = classify(a, b.sample, pose, FusionSettings())
    assert np.array_equal(labels, plain_labels(a, b.sample, pose, FusionSettings()))


def test_refinement_ends_where_the_walls_pull_no_more(pair) -> None:
    a, b, truth = pair
    result = refine(a, b.sample, compose((0.1, -0.1, 0.02), truth), 0.4, wall_m=b.wall_m)
    gap = result.pose - truth
    assert np.hypot(gap[0], gap[1]) < 0.1
    again = refine(a, b.sample, result.pose, 0.15, wall_m=b.wall_m)
    assert np.abs(again.pose - result.pose).max() < 1e-3
    assert (np.linalg.eigvalsh(result.information) > 0).all()


def test_a_blob_is_as_long_as_its_largest_connected_part() -> None:
    line = np.stack([np.arange(0.05, 3, 0.05), np.full(59, 1.1)], axis=1)
    assert longest_blob(np.concatenate([line, [[10.1, 10.1]]])) == pytest.approx(3.0)
    assert longest_blob(np.zeros((0, 2))) == 0
    assert longest_blob(np.array([[5.0, 5.0]])) == pytest.approx(0.2)


def test_a_rigid_fit_recovers_the_pose_and_no_scale() -> None:
    points = np.random.default_rng(0).uniform(-9, 9, (20, 2))
    assert fit_rigid(apply(AWAY, points), points) == pytest.approx(AWAY)
    assert fit_rigid(1.1 * apply(AWAY, points), points)[2] == pytest.approx(AWAY[2])
