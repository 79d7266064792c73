"""Walls are published as sharp as their hits allow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.grid import TILE
from common.grid.sharpen import keep_peaks, sharpened


def keep_peaks_numpy(hits: NDArray[np.uint16]) -> NDArray[np.uint16]:
    windows = np.lib.stride_tricks.sliding_window_view(hits, (3, 3)).astype(np.int64)
    inner = hits[1:-1, 1:-1]
    return np.where(5 * inner.astype(np.int64) >= 2 * windows.max(axis=(2, 3)), inner, 0).astype(np.uint16)


def test_the_kernel_does_what_its_numpy_twin_does() -> None:
    hits = np.random.default_rng(1).integers(0, 300, (66, 66)).astype(np.uint16)
    hits[hits < 150] = 0
    assert np.array_equal(keep_peaks(hits), keep_peaks_numpy(hits))


def test_hits_spread_behind_a_wall_go_and_visits_stay() -> None:
    tile = np.zeros((2, TILE, TILE), np.uint16)
    tile[:, :, 30] = 100
    tile[:, :, 31] = 30
    out = sharpened({(0, 0): tile}, (0, 0))
    assert (out[0, :, 30] == 100).all()
    assert not out[0, :, 31].any()
    assert np.array_equal(out[1], tile[1])


def test_both_faces_of_a_thin_wall_stay() -> None:
    tile = np.zeros((2, TILE, TILE), np.uint16)
    tile[:, :, 30] = 100
    tile[:, :, 31] = 60
    assert np.array_equal(sharpened({(0, 0): tile}, (0, 0)), tile)


def test_a_wall_in_the_next_tile_is_seen_across_the_border() -> None:
    left, right = np.zeros((2, TILE, TILE), np.uint16), np.zeros((2, TILE, TILE), np.uint16)
    left[:, :, TILE - 1] = 100
    right[:, :, 0] = 30
    out = sharpened({(0, 0): left, (1, 0): right}, (1, 0))
    assert not out[0].any()
