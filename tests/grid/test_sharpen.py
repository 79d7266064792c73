"""Walls are published as sharp as their hits allow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.grid import TILE
from common.grid.sharpen import MARGIN, REACH, drop_specks, keep_peaks, sharpened


def keep_peaks_numpy(hits: NDArray[np.uint16]) -> NDArray[np.uint16]:
    windows = np.lib.stride_tricks.sliding_window_view(hits, (3, 3)).astype(np.int64)
    inner = hits[1:-1, 1:-1]
    return np.where(5 * inner.astype(np.int64) >= 2 * windows.max(axis=(2, 3)), inner, 0).astype(np.uint16)


def drop_specks_numpy(hits: NDArray[np.uint16]) -> NDArray[np.uint16]:
    side = 2 * REACH + 1
    windows = np.lib.stride_tricks.sliding_window_view(hits, (side, side)).astype(np.int64)
    around = windows[:, :, REACH - 1 : REACH + 2, REACH - 1 : REACH + 2].sum(axis=(2, 3))
    return np.where(10 * around >= windows.max(axis=(2, 3)), hits[REACH:-REACH, REACH:-REACH], 0).astype(np.uint16)


def test_the_kernels_do_what_their_numpy_twins_do() -> None:
    hits = np.random.default_rng(1).integers(0, 300, (66, 66)).astype(np.uint16)
    hits[hits < 150] = 0
    assert np.array_equal(keep_peaks(hits), keep_peaks_numpy(hits))
    sparse = np.random.default_rng(2).integers(0, 65536, (70, 70)).astype(np.uint16)
    sparse[np.random.default_rng(3).random(sparse.shape) < 0.9] //= 4096
    assert np.array_equal(drop_specks(sparse), drop_specks_numpy(sparse))
    assert (drop_specks(sparse) != sparse[REACH:-REACH, REACH:-REACH]).any()


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


def test_a_speck_behind_a_wall_goes_and_a_pole_before_it_stays() -> None:
    tile = np.zeros((2, TILE, TILE), np.uint16)
    tile[:, :, 30] = 200
    tile[:, 20, 33] = 3
    tile[:, 40:42, 27] = 15
    out = sharpened({(0, 0): tile}, (0, 0))
    assert not out[0, :, 33].any()
    assert (out[0, 40:42, 27] == 15).all()


def test_a_tile_is_sharpened_as_it_would_be_amid_one_large_map() -> None:
    rng = np.random.default_rng(5)
    hits = rng.integers(0, 200, (3 * TILE, 3 * TILE)).astype(np.uint16)
    hits[rng.random(hits.shape) < 0.8] //= 64
    whole = drop_specks(keep_peaks(hits))
    cuts = [slice(k * TILE, (k + 1) * TILE) for k in range(3)]
    tiles = {(x, y): np.stack([hits[cuts[y], cuts[x]]] * 2) for x in range(3) for y in range(3)}
    middle = slice(TILE - MARGIN, 2 * TILE - MARGIN)
    assert np.array_equal(sharpened(tiles, (1, 1))[0], whole[middle, middle])
