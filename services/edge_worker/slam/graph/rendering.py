"""The robot map drawn from keyframes: only what has moved is drawn again.

A keyframe, with the views that hang on it, is drawn at its pose rounded to a fraction of a cell, so that the map is a
pure function of the graph, whenever and however often it was drawn before, and corrections too small to see cost
nothing. Drawing can be done in slices on a canvas that nobody sees; the grid changes when all of it is done, so that no
map is half corrected.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from common.geometry import compose
from common.grid import Grid
from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.graph.keyframe import Keyframe
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
        """(n, 3) rounded poses at which the first keyframes are on the canvas"""
        self._shown = self._drawn
        """(m, 3) the same of those in the grid"""
        self._gone: list[tuple[Keyframe, NDArray[np.int64]]] = []
        """keyframes that are no more, and where they still are on the canvas"""
        self._steps = np.array([resolution * ROUND_CELLS, resolution * ROUND_CELLS, ROUND_RAD])

    def update(self, keyframes: list[Keyframe], poses: NDArray[np.float64]) -> Grid:
        """The grid with every keyframe at its pose (n, 3)."""
        self.prepare(keyframes, poses, math.inf)
        self._canvas.publish(self.grid)
        self._shown = self._drawn.copy()
        self.corrections.shown()
        return self.grid

    def prepare(self, keyframes: list[Keyframe], poses: NDArray[np.float64], seconds: float) -> bool:
        """Draw for about `seconds` what `update` would; returns whether it has nothing left to draw."""
        end = time.perf_counter() + seconds
        wanted = np.rint(poses / self._steps).astype(np.int64)
        moved = np.flatnonzero((wanted[: len(self._drawn)] != self._drawn).any(axis=1))
        if len(moved) > ANEW_SHARE * len(self._drawn):
            self._wipe()
            moved = moved[:0]
        while self._gone:
            self._draw(*self._gone.pop(), -1)
            if time.perf_counter() > end:
                return False
        known, done = len(self._drawn), 0
        todo = [*moved.tolist(), *range(known, len(keyframes))]
        for k in todo:
            if k < known:
                self._draw(keyframes[k], self._drawn[k], -1)
            self._draw(keyframes[k], wanted[k], 1)
            if k < len(self._shown) and (self._shown[k] != wanted[k]).any():
                self.corrections.moves(keyframes[k].points, self._shown[k] * self._steps, wanted[k] * self._steps)
            done += 1
            if time.perf_counter() > end:
                break
        self._drawn = np.concatenate([self._drawn, wanted[known : known + max(0, done - len(moved))]])
        self._drawn[todo[:done]] = wanted[todo[:done]]
        return done == len(todo)

    def forget(self, keyframes: list[Keyframe], gone: NDArray[np.int64]) -> None:
        """Keyframes are about to be dropped: they are taken away with what is drawn next."""
        drawn = gone[gone < len(self._drawn)]
        self._gone += [(keyframes[k], self._drawn[k]) for k in drawn.tolist()]
        self._drawn = np.delete(self._drawn, drawn, axis=0)
        self._shown = np.delete(self._shown, gone[gone < len(self._shown)], axis=0)

    def restart(self, version: int) -> None:
        """Forget what was drawn; the grid goes on from `version`, its tiles to be drawn again."""
        self._wipe()
        self._shown = self._shown[:0]
        self.grid.version = max(self.grid.version, version)

    def _wipe(self) -> None:
        self._canvas.clear()
        self._drawn = self._drawn[:0]
        self._gone.clear()

    def _draw(self, keyframe: Keyframe, rounded: NDArray[np.int64], times: int) -> None:
        pose = rounded * self._steps
        for view in keyframe.views:
            self._canvas.draw(compose(pose, view.pose), view.ends, view.laser, view.silent, times, view.joined)
