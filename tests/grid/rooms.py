"""Rooms that rendering is tried on."""

import numpy as np

from common.grid import Grid

RESOLUTION = 0.05


def room(*, cut_off: bool = False) -> Grid:
    """A closed room of 7 x 5 m with one-cell walls, off the origin; one of its corners cut off diagonally or not."""
    counts = np.zeros((2, 120, 160), np.uint16)
    counts[1, 10:110, 10:150] = 9
    counts[0, 10, 10:150] = counts[0, 109, 10:150] = 9
    counts[0, 10:110, 10] = counts[0, 10:110, 149] = 9
    for k in range(40 if cut_off else 0):
        counts[0, 70 + k, 10 + k] = 9
    return Grid.from_dense(counts, (-57, 31), RESOLUTION)
