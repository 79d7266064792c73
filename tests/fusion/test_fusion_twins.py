"""Compiled kernels agree with plain numpy, written from their definitions."""

import cv2
import numpy as np
import pytest
from drawn_worlds import apartment, mapped

from common.fusion.correlate import _peaks
from common.fusion.evidence import AGREES, CONTRADICTS, NEITHER, OUTSIDE, classify, pieces_m
from common.fusion.features import RATIO, _matches, fit_rigid
from common.fusion.hypotheses import APART_M, APART_RAD, distinct
from common.fusion.matchmap import REACH_M, MatchMap
from common.fusion.refine import refine, refine_all
from common.fusion.settings import FusionSettings
from common.fusion.walls import STRAIGHT, _free_before, _free_sides
from common.geometry import apply, between, compose, wrap

HOME, AWAY = np.array([3.0, 2.0, 0.3]), np.array([-4.0, 7.0, 2.0])


@pytest.fixture(scope="module")
def pair() -> tuple[MatchMap, MatchMap, np.ndarray]:
    world = apartment(2)
    return mapped(world, HOME, (0, 11)), mapped(world, AWAY, (5, 16), seed=2), between(HOME, AWAY)


def distance(map_: MatchMap, row: int, column: int) -> float:
    """From a cell's centre to that of the nearest wall cell, m."""
    return float(map_.nearest.distance(np.array([row]), np.array([column]))[0])


def test_the_nearest_wall_is_the_nearest_wall(pair) -> None:
    a = pair[0]
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, a.occupancy.shape, (300, 2)):
        gaps = np.linalg.norm(a.walls.cells - (row, column), axis=1) * a.resolution
        if gaps.min() <= REACH_M:
            assert distance(a, row, column) == pytest.approx(gaps.min(), abs=1e-9)
            assert a.nearest.wall[row, column] == gaps.argmin()
        else:
            assert distance(a, row, column) == np.inf


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


def test_free_cells_before_and_behind_a_line_are_counted_one_by_one(pair) -> None:
    free, reach, rng = np.pad(pair[0].occupancy, 6, constant_values=-1) == 0, 6, np.random.default_rng(3)
    before = _free_before(np.where(free, 0, -1).astype(np.int8))
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    angles = [*rng.uniform(-np.pi, np.pi, 60), 0.0, np.pi / 2, np.pi, -np.pi / 2, np.pi / 4]
    for angle in angles:
        row, column = rng.integers(reach, np.array(free.shape) - reach)
        nx, ny = np.cos(angle), np.sin(angle)
        around = free[row - reach : row + reach + 1, column - reach : column + reach + 1]
        side = nx * dx + ny * dy
        plain = (around & (side > 1)).sum(), (around & (side < -1)).sum()
        assert _free_sides(before, row, column, reach, nx, ny) == plain


def test_peaks_are_the_highest_local_maxima() -> None:
    rng = np.random.default_rng(4)
    for count in (1, 8, 40):
        scores = rng.normal(size=(50, 70)).astype(np.float32)
        scores[rng.integers(0, 50, 9), rng.integers(0, 70, 9)] = 3.0  # as high as each other
        tops = [
            (-scores[y, x], y, x)
            for y, x in np.ndindex(scores.shape)
            if scores[y, x] > 0 and scores[y, x] == scores[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3].max()
        ]
        assert _peaks(scores, count).tolist() == [[y, x] for _, y, x in sorted(tops)[:count]]
    assert len(_peaks(-np.ones((9, 9), np.float32), 3)) == 0


def test_distinct_poses_are_those_far_from_every_earlier_one_that_is_kept() -> None:
    rng, middle = np.random.default_rng(6), np.array([3.0, -2.0])
    poses = np.column_stack([rng.uniform(0, 2, (80, 2)), np.pi + rng.uniform(-0.3, 0.3, 80)])
    kept: list[int] = []
    for k, pose in enumerate(poses):
        gaps = [apply(pose, middle[None])[0] - apply(poses[i], middle[None])[0] for i in kept]
        turns = [abs(wrap(pose[2] - poses[i, 2])) for i in kept]
        if not any(np.hypot(*gap) <= APART_M and turn <= APART_RAD for gap, turn in zip(gaps, turns, strict=True)):
            kept.append(k)
    assert 10 < len(kept) < 80
    assert distinct(poses, middle) == kept


def plain_labels(target: MatchMap, walls, pose: np.ndarray, settings: FusionSettings) -> np.ndarray:
    """`classify` from its definition."""
    labels = np.full(len(walls.points), OUTSIDE)
    points = apply(pose, walls.points)
    normals = apply((0, 0, pose[2]), walls.normals)
    eroded = cv2.erode((target.occupancy == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    for k, (column, row) in enumerate(np.floor((points - target.origin) / target.resolution).astype(int)):
        if not (0 < row < target.occupancy.shape[0] - 1 and 0 < column < target.occupancy.shape[1] - 1):
            continue
        gap, wall = distance(target, row, column), target.nearest.wall[row, column]
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


def test_many_poses_are_refined_as_each_alone(pair) -> None:
    a, b, truth = pair
    starts = compose(truth, np.random.default_rng(8).normal(0, 0.1, (12, 3)))
    alone = [refine(a, b.sample, start, 0.4, 7).pose for start in starts]
    assert np.array_equal(refine_all(a, b.sample, starts, 0.4, 7), np.array(alone))


def test_a_blob_is_as_long_as_its_largest_connected_part() -> None:
    line = np.stack([np.arange(0.05, 3, 0.05), np.full(59, 1.1)], axis=1)
    assert sorted(pieces_m(np.concatenate([line, [[10.1, 10.1]]]))) == pytest.approx([0.2, 3.0])
    assert len(pieces_m(np.zeros((0, 2)))) == 0
    assert pieces_m(np.array([[5.0, 5.0]])) == pytest.approx([0.2])


def test_a_rigid_fit_recovers_the_pose_and_no_scale() -> None:
    points = np.random.default_rng(0).uniform(-9, 9, (20, 2))
    assert fit_rigid(apply(AWAY, points), points) == pytest.approx(AWAY)
    assert fit_rigid(1.1 * apply(AWAY, points), points)[2] == pytest.approx(AWAY[2])
