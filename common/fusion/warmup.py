"""Compiling everything that fusion needs, so that no first merge waits for it."""

from __future__ import annotations

import numpy as np

from common.fusion.bend import bend, loosened, weigh_bent
from common.fusion.match import match, track
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.grid import Grid
from common.grid.render import render


def warmup() -> None:
    """Run matching and rendering once on a small furnished room; compiled code is kept on disk for the next process."""
    counts = np.zeros((2, 160, 240), np.uint16)
    counts[1, 10:150, 10:230] = 4
    counts[0, 10, 10:230] = counts[0, 149, 10:230] = counts[0, 10:110, 10] = counts[0, 10:150, 229] = 4
    for y, x in np.random.default_rng(0).integers(20, (130, 210), (30, 2)):  # enough to have key points
        counts[0, y : y + 9, x] = counts[0, y, x : x + 14] = 4
    grid = Grid.from_dense(counts, (0, 0), 0.05)
    a, b = MatchMap.from_grid(grid), MatchMap.from_grid(render(grid, (1.0, 2.0, 0.5), 0.05))
    settings, found = FusionSettings(), match(a, b)
    pose = np.zeros(3) if found.transform is None else found.transform
    track(a, b, pose)
    bent = bend(a, b, pose, settings)
    weigh_bent(a, b, bent, settings)
    loosened(np.eye(3), b, pose, bent)
