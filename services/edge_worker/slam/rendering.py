"""The robot map drawn from keyframes: only what has moved is drawn again.

A keyframe is drawn at its pose rounded to a fraction of a cell, so that the map is a pure function of the graph,
whenever and however often it was drawn before, and corrections too small to see cost nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.grid import Grid
from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.keyframe import Keyframe
from services.edge_worker.slam.raycast import Canvas

ROUND_CELLS = 0.2
"""of a cell"""
ROUND_RAD = 0.002
ANEW_SHARE = 0.5
"""when more keyframes than this have moved, all are drawn anew: that is one drawing each, not two"""


class Rendering:
    """Keeps one grid up to date with the keyframes."""

    def __init__(self, resolution: float) -> None:
        self.grid = Grid(resolution)
        self.corrections = Corrections(resolution)
        self._canvas = Canvas(resolution)
        self._drawn = np.empty((0, 3), np.int64)
        self._steps = np.array([resolution * ROUND_CELLS, resolution * ROUND_CELLS, ROUND_RAD])

    def update(self, keyframes: list[Keyframe], poses: NDArray[np.float64]) -> Grid:
        """The grid with every keyframe at its pose (n, 3)."""
        wanted = np.rint(poses / self._steps).astype(np.int64)
        moved = np.flatnonzero((wanted[: len(self._drawn)] != self._drawn).any(axis=1))
        for k in moved.tolist():
            self.corrections.moves(keyframes[k].points, self._drawn[k] * self._steps, wanted[k] * self._steps)
        if len(moved) > ANEW_SHARE * len(self._drawn):
            self._canvas.clear()
            self._drawn = self._drawn[:0]
        else:
            for k in moved.tolist():
                self._draw(keyframes[k], self._drawn[k], -1)
                self._draw(keyframes[k], wanted[k], 1)
        for k in range(len(self._drawn), len(keyframes)):
            self._draw(keyframes[k], wanted[k], 1)
        self._drawn = wanted
        self._canvas.publish(self.grid)
        self.corrections.shown()
        return self.grid

    def forget(self, keyframes: list[Keyframe], gone: NDArray[np.int64]) -> None:
        """Take keyframes away that are about to be dropped."""
        drawn = gone[gone < len(self._drawn)]
        for k in drawn.tolist():
            self._draw(keyframes[k], self._drawn[k], -1)
        self._drawn = np.delete(self._drawn, drawn, axis=0)

    def restart(self, version: int) -> None:
        """Forget what was drawn; the grid goes on from `version`, its tiles to be drawn again."""
        self._canvas.clear()
        self._drawn = np.empty((0, 3), np.int64)
        self.grid.version = max(self.grid.version, version)

    def _draw(self, keyframe: Keyframe, rounded: NDArray[np.int64], times: int) -> None:
        self._canvas.draw(rounded * self._steps, keyframe.points, keyframe.laser, keyframe.silent, times)
