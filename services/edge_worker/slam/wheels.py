"""What is wrong with a robot's wheels, learned from what matching says that they should have told.

Wheels wear and tyres lose air: odometry errs by a share of the distance. And wheels slip: for a moment they tell of a
speed that no robot reaches as suddenly. What a surge tells over the usual speed is not believed then, or a corridor
that looks the same all along grows longer with every slip.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SCALE_MEMORY_M, SCALE_BASE_M = 200.0, 2.0
"""metres of driving that the scale is learned from, at most, and before it is believed in full"""
SCALE_LIMIT = 0.25
"""share by which wheels can err in distance; more is slip, or a wrong match"""
SCALE_STEP_M = 0.03
"""shorter motion says nothing about the scale: frames are taken together up to this"""
LONGEST_STEP_M = 1.0
"""longer motion may be a reset"""
SPEED_BASE_S = 0.08
"""s; a motion over less tells no speed, as stamps jitter: frames are taken together up to this"""
USUAL_S, FEWEST_SPEEDS = 2.0, 5
"""s over which speeds tell the usual one, and how many of them at least"""
BUNCH = 3
"""speeds over which stamps that bunch make up for each other"""
SURGE_SHARE, SURGE_MPS = 1.5, 0.1
"""share of the usual speed, and m/s over that, beyond which wheels may be slipping"""
ACCELERATION = 2.0
"""m/s^2 beyond which they are"""


class Wheels:
    """One robot's wheels."""

    def __init__(self) -> None:
        self.scale = 1.0
        """metres driven per metre that odometry tells"""
        self.scale_m = 0.0
        """m of motion that the scale was learned from"""
        self.learning = np.zeros(2)
        """m by matching and by odometry of the latest frames: too few yet to tell a scale"""
        self.lesson = np.empty(0)
        """(2,) scale by the latest frames, and m; not taken yet, as slip may just have begun; empty for none"""
        self.calm = 0
        """frames since wheels surged"""
        self.steps = np.empty((0, 2))
        """(k, 2) of the latest frames: m ahead (behind: negative), and s"""
        self.step = np.zeros(2)
        """(2,) the same since the last one of them: too short yet to tell a speed"""
        self.surge = 0.0
        """m by which odometry told more than the usual speed in the latest frame: slip, as likely as not"""
        self.slipping = False
        """the surge came too suddenly to be anything else"""

    def scaled(self, told: NDArray[np.float64]) -> NDArray[np.float64]:
        """Motions (..., 3) that odometry told, in true metres."""
        return told * np.array([self.scale, self.scale, 1.0])

    def watch(self, motion: NDArray[np.float64], dt: float) -> float:
        """Compare the next frame's motion (3,) over `dt` s with the usual speed; the share of it to be believed."""
        ahead = _ahead(motion)
        self.step = self.step + np.array([ahead, dt])
        self.surge = self._excess(ahead, dt) if self.slipping else 0.0
        if self.step[1] >= SPEED_BASE_S:
            self._judge()
        self._take_lesson()
        return max(1.0 - self.surge / abs(ahead), 0.0) if self.slipping and ahead else 1.0

    def believed(self, motion: NDArray[np.float64], dt: float) -> float:
        """The share to be believed of a motion (3,) within a sweep of `dt` s, begun after the latest frame."""
        step = _ahead(motion)
        surge = self._excess(step, dt)
        return 1.0 - surge / abs(step) if surge > 0.0 and (self.slipping or self._sudden(step / dt)) else 1.0

    def unwatched(self) -> None:
        """The next frame tells no speed: its motion was not measured, or its stamp is no later, or much."""
        self.surge, self.slipping = 0.0, False
        self.step = np.zeros(2)
        self._take_lesson()

    def learn(self, motion: NDArray[np.float64], told: NDArray[np.float64]) -> None:
        """Compare the matched motion (3,), held by the walls alone, with what odometry told.

        Frames next to a surge are left out: as slip begins and ends, a part of them is slip.
        """
        length = float(np.hypot(told[0], told[1]))
        if self.calm < 2 or not 0.0 < length <= LONGEST_STEP_M:
            self.learning = np.zeros(2)
            return
        self.learning = self.learning + np.array([motion[:2] @ told[:2] / length, length])
        matched, length = self.learning.tolist()
        if length < SCALE_STEP_M:
            return
        # Both are noisy: a limit to a share of only one of them would choose frames in which that one is large.
        if abs(length * self.scale - matched) <= SCALE_LIMIT * (length * self.scale + matched) / 2:
            self.lesson = np.array([matched / length, length])
        self.learning = np.zeros(2)

    def state(self) -> dict[str, Any]:
        """Everything, as msgpack and arrays take it."""
        return dict(vars(self))

    @classmethod
    def of(cls, state: dict[str, Any]) -> Wheels:
        """The inverse of `state`."""
        self = cls()
        for name in vars(self):
            setattr(self, name, state[name])
        return self

    @property
    def _usual(self) -> float:
        """m/s ahead (behind: negative)."""
        return float(np.median(self.steps[:, 0] / self.steps[:, 1]))

    def _judge(self) -> None:
        """Compare the latest motion, long enough by now to tell a speed, with the usual one."""
        ahead, seconds = self.step.tolist()
        surge = self._excess(ahead, seconds)
        self.surge = min(surge, self.surge) if self.slipping else surge
        self.slipping = surge > 0.0 and (self.slipping or self._sudden(ahead / seconds))
        self.steps = np.vstack([self.steps, (ahead, seconds)])
        self.steps = self.steps[np.cumsum(self.steps[::-1, 1])[::-1] <= USUAL_S + seconds]
        self.step = np.zeros(2)

    def _take_lesson(self) -> None:
        """Learn from the frame before, unless wheels surge by now."""
        lesson, self.lesson = self.lesson, np.empty(0)
        self.calm = 0 if self.surge > 0.0 else self.calm + 1
        if self.calm and len(lesson):
            scale, length = lesson.tolist()
            self.scale_m = min(self.scale_m + length, SCALE_MEMORY_M)
            self.scale += min(length / max(self.scale_m, SCALE_BASE_M), 1.0) * (scale - self.scale)
            self.scale = float(np.clip(self.scale, 1.0 - SCALE_LIMIT, 1.0 + SCALE_LIMIT))

    def _excess(self, step: float, dt: float) -> float:
        """m by which the next frame, and it together with those before it, surpass the usual speed."""
        if len(self.steps) < FEWEST_SPEEDS:
            return 0.0
        usual = self._usual
        way = 1.0 if usual >= 0.0 else -1.0
        if step * way <= (SURGE_SHARE * abs(usual) + SURGE_MPS) * dt:
            return 0.0
        over = np.append((self.steps[1 - BUNCH :] @ (1.0, -usual)), step - usual * dt) * way
        return max(float(np.cumsum(over[::-1]).min()), 0.0)

    def _sudden(self, speed: float) -> bool:
        """Does a surging speed come of slip? A robot that stood may have started."""
        step, dt = self.steps[-1].tolist()
        return abs(speed - step / dt) > ACCELERATION * dt and abs(self._usual) > SURGE_MPS


def _ahead(motion: NDArray[np.float64]) -> float:
    """Metres of a motion (3,), negative for one backwards."""
    length = float(np.hypot(motion[0], motion[1]))
    return -length if motion[0] < 0.0 else length
