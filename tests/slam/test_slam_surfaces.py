"""Promises of where a scan's beams met walls."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from services.edge_worker.slam.surfaces import FEWEST, LONGEST, PRICE, fit, noise, walls

LASER = np.array([0.1, -0.05])
BEARINGS = np.radians(np.arange(-60.0, 60.0))
BEAMS = np.arange(len(BEARINGS), dtype=np.int32)


def room(bearings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranges in a corner: a wall 5 m ahead, with a niche 0.4 m deep in it, and one 4 m to the left."""
    with np.errstate(divide="ignore"):
        ahead, left = 5.0 / np.cos(bearings), np.where(bearings > 0, 4.0 / np.sin(bearings), np.inf)
    ahead[40:50] *= 5.4 / 5.0
    return np.asarray(np.minimum(ahead, left))


def placed(ranges: NDArray[np.float64]) -> NDArray[np.float32]:
    directions = np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])
    return (LASER + ranges[:, None] * directions).astype(np.float32)


def fit_numpy(
    u: NDArray[np.float64], basis: NDArray[np.float64], w: NDArray[np.float64]
) -> tuple[float, list[tuple[int, int]]]:
    """The least cost of all cuts of `u` (n,) into lines, and the lines, each fitted by itself."""
    best: list[tuple[float, list[tuple[int, int]]]] = [(0.0, [])]
    for end in range(1, len(u) + 1):
        options = []
        for first in range(max(0, end - LONGEST), end):
            error = 0.0
            if end - first >= FEWEST:
                rows, root = slice(first, end), np.sqrt(w[first:end])
                solution = np.linalg.lstsq(basis[rows] * root[:, None], u[rows] * root, rcond=None)[0]
                error = float((w[rows] * (u[rows] - basis[rows] @ solution) ** 2).sum())
            options.append((best[first][0] + PRICE + error, [*best[first][1], (first, end)]))
        best.append(min(options, key=lambda option: option[0]))
    return best[-1]


@pytest.mark.parametrize("seed", range(5))
def test_the_lines_are_the_best_that_there_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigma = np.full(60, 0.03)
    ranges = room(BEARINGS)[30:90] + sigma * rng.normal(size=60)
    c, s = np.cos(BEARINGS[30:90]), np.sin(BEARINGS[30:90])
    fitted, joined = fit(ranges, c, s, sigma, np.zeros(60, np.bool_))
    _, lines = fit_numpy(1 / ranges, np.column_stack([c, s]), (ranges**2 / sigma) ** 2)
    wanted = np.zeros(60, np.bool_)
    for first, end in lines:
        wanted[first : end - 1] = end - first >= FEWEST
        if end - first < FEWEST:
            assert np.array_equal(fitted[first:end], ranges[first:end])
    assert np.array_equal(joined, wanted)


def test_ends_on_walls_come_nearer_to_the_truth_and_stay_on_their_beams() -> None:
    true = room(BEARINGS)
    before, after = [], []
    for seed in range(20):
        measured = true * (1 + 0.01 * np.random.default_rng(seed).normal(size=len(true)))
        ends, _ = walls(placed(measured), BEAMS, LASER)
        found = np.hypot(*(ends - LASER).T)
        assert placed(found) == pytest.approx(ends, abs=1e-5)
        before.append(measured - true)
        after.append(found - true)
    assert np.sqrt(np.mean(np.square(after))) < 0.6 * np.sqrt(np.mean(np.square(before)))


def test_a_niche_stays_one() -> None:
    measured = room(BEARINGS) * (1 + 0.01 * np.random.default_rng(1).normal(size=len(BEARINGS)))
    ends, joined = walls(placed(measured), BEAMS, LASER)
    assert np.abs(ends[41:49, 0] - LASER[0] - 5.4).mean() < 0.05
    assert not joined[39]
    assert not joined[49]


def test_a_scan_tells_how_large_its_errors_are() -> None:
    c, s = np.cos(BEARINGS), np.sin(BEARINGS)
    for share in (0.005, 0.01, 0.02):
        found = [
            noise(room(BEARINGS) * (1 + share * np.random.default_rng(seed).normal(size=len(c))), c, s, BEAMS)
            for seed in range(20)
        ]
        assert np.median(found) == pytest.approx(share, rel=0.2)


def test_there_is_no_wall_across_missing_beams_or_from_one_surface_to_another() -> None:
    true = np.concatenate([5.0 / np.cos(BEARINGS[:60]), np.full(60, 2.0)])
    kept = np.r_[0:20, 30:120]
    _, joined = walls(placed(true)[kept], BEAMS[kept], LASER)
    assert joined[12:19].all()
    assert not joined[19]
    assert not joined[49]
    assert not joined[-1]


@pytest.mark.parametrize("count", range(4))
def test_scans_of_few_or_coinciding_points_are_left_as_they_are(count: int) -> None:
    points = np.ones((count, 2), np.float32)
    ends, joined = walls(points, np.arange(count, dtype=np.int32), np.zeros(2))
    assert np.array_equal(ends, points)
    assert not joined[-1:].any()
