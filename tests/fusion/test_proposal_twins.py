"""Compiled kernels of the proposals agree with plain numpy, written from their definitions."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from drawn_worlds import apartment, mapped

from common.fusion.correlate import _products, _spectrum, rasters
from common.fusion.features import INLIER_M, MIN_SPREAD_M, _most_agreed, fit_rigid
from common.fusion.matchmap import MatchMap
from common.geometry import apply

AWAY = np.array([-4.0, 7.0, 2.0])


@pytest.fixture(scope="module")
def map_() -> MatchMap:
    return mapped(apartment(4), AWAY, (0, 11))


def test_free_points_are_the_centres_of_free_cells_in_even_rows_and_columns(map_: MatchMap) -> None:
    rows, columns = np.nonzero(map_.occupancy == 0)
    even = (rows % 2 == 0) & (columns % 2 == 0)
    expected = map_.origin + (np.stack([columns, rows], axis=1)[even] + 0.5) * map_.resolution
    assert np.array_equal(map_.free_points, expected)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.2])
def test_turned_rasters_hold_walls_and_what_is_free_away_from_them(map_: MatchMap, angle: float) -> None:
    wall, free, low = rasters(map_.walls.points, map_.free_points, angle, 0.25)
    cells = [np.floor(apply((0, 0, angle), p) / 0.25).astype(int) for p in (map_.walls.points, map_.free_points)]
    walls, open_ = np.zeros((2, *wall.shape), bool)
    assert np.array_equal(low, cells[0].min(axis=0) - 1)
    assert wall.shape == tuple((cells[0].max(axis=0) + 2 - low)[::-1])
    for raster, places in zip((walls, open_), cells, strict=True):
        x, y = (places - low).T
        inside = (x >= 0) & (y >= 0) & (x < wall.shape[1]) & (y < wall.shape[0])
        raster[y[inside], x[inside]] = True
    assert np.array_equal(wall > 0, walls)
    assert np.array_equal(free > 0, open_ & (cv2.dilate(walls.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0))


def test_spectra_are_multiplied_as_the_formula_says() -> None:
    rng = np.random.default_rng(1)
    attract, repel, walls, free = (_spectrum(rng.normal(size=(9, 14)).astype(np.float32), (20, 24)) for _ in range(4))
    forth, back = _products(attract, repel, walls, free)
    assert np.allclose(forth, attract * walls.conj() + repel * free.conj(), atol=1e-3)
    assert np.allclose(back, attract * walls + repel * free, atol=1e-3)


def test_a_spectrum_of_filled_up_rows_is_that_of_the_whole() -> None:
    raster = np.random.default_rng(2).normal(size=(9, 14)).astype(np.float32)
    assert np.allclose(_spectrum(raster, (20, 24)), np.fft.rfft2(raster, (20, 24)), atol=1e-4)


def test_of_the_poses_that_two_matches_fix_the_one_most_agree_on_is_found() -> None:
    rng = np.random.default_rng(3)
    points_b = rng.uniform(-9, 9, (50, 2))
    points_a = np.concatenate([apply(AWAY, points_b[:20]) + rng.normal(0, 0.05, (20, 2)), rng.uniform(-9, 9, (30, 2))])
    draws = rng.integers(0, 50, (300, 2))
    most, best = 0, np.zeros(3)
    for draw in draws:
        length = [math.dist(*points[draw]) for points in (points_a, points_b)]
        if length[0] > MIN_SPREAD_M and abs(length[0] - length[1]) < INLIER_M:
            pose = fit_rigid(points_a[draw], points_b[draw])
            agreed = int((np.linalg.norm(apply(pose, points_b) - points_a, axis=1) < INLIER_M).sum())
            if agreed > most:
                most, best = agreed, pose
    found, pose = _most_agreed(points_a, points_b, draws)
    assert found == most >= 18
    assert pose == pytest.approx(best)


def test_matches_that_lie_in_one_place_fix_no_pose() -> None:
    points = np.zeros((6, 2))
    assert _most_agreed(points, points, np.array([[0, 1], [2, 2]]))[0] == 0
