"""Compiling everything that fusion needs, so that no first merge waits for it."""

from __future__ import annotations

import numpy as np

from common.fusion.bend import bend, weigh_bent
from common.fusion.match import match, track
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.grid import Grid
from common.grid.render import render


def warmup() -> None:
    """Run matching and rendering once on a small room; compiled code is kept on disk for the next process."""
    counts = np.zeros((2, 80, 120), np.uint16)
    counts[1, 10:70, 10:110] = 4
    counts[0, 10, 10:110] = counts[0, 69, 10:110] = counts[0, 10:50, 10] = counts[0, 10:70, 109] = 4
    grid = Grid.from_dense(counts, (0, 0), 0.1)
    a, b = MatchMap.from_grid(grid), MatchMap.from_grid(render(grid, (1.0, 2.0, 0.5), 0.1))
    match(a, b)
    track(a, b, np.zeros(3))
    weigh_bent(a, b, bend(a, b, np.zeros(3), FusionSettings()), FusionSettings())
