"""Where the robot was at each frame: each frame hangs on a keyframe, so a correction moves it along."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose


class Trajectory:
    """Frames taken so far, in order."""

    def __init__(self) -> None:
        self._stamps = np.empty(1024)
        self._keyframes = np.empty(1024, np.int32)
        self._relative = np.empty((1024, 3))
        self._count = 0

    def append(self, stamp: float, keyframe: int, relative: NDArray[np.float64]) -> None:
        """`relative` is the pose (3,) in the frame of the keyframe."""
        if self._count == len(self._stamps):
            self._stamps = np.concatenate([self._stamps, np.empty_like(self._stamps)])
            self._keyframes = np.concatenate([self._keyframes, np.empty_like(self._keyframes)])
            self._relative = np.concatenate([self._relative, np.empty_like(self._relative)])
        self._stamps[self._count], self._keyframes[self._count] = stamp, keyframe
        self._relative[self._count] = relative
        self._count += 1

    def rehang(self, poses: NDArray[np.float64], heir: NDArray[np.int64], number: NDArray[np.int64]) -> None:
        """Move frames from keyframes at `poses` (k, 3) to their heirs (k,), which get new numbers (k,)."""
        n = self._count
        old = self._keyframes[:n]
        self._relative[:n] = compose(between(poses[heir], poses)[old], self._relative[:n])
        self._keyframes[:n] = number[heir[old]]

    def state(self) -> list[NDArray[Any]]:
        """Stamps, keyframes and relative poses."""
        n = self._count
        return [self._stamps[:n], self._keyframes[:n], self._relative[:n]]

    @classmethod
    def of(cls, state: list[NDArray[Any]]) -> Trajectory:
        """The inverse of `state`."""
        self = cls()
        for stamp, keyframe, relative in zip(*state, strict=True):
            self.append(float(stamp), int(keyframe), relative)
        return self

    def rows(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 4): stamp s, x m, y m, theta rad, with keyframes at `poses` (k, 3)."""
        n = self._count
        if n == 0:
            return np.empty((0, 4))
        return np.column_stack([self._stamps[:n], compose(poses[self._keyframes[:n]], self._relative[:n])])
