"""What a gyro tells of the rotation, freed of its bias, which is learned from the matched rotation.

The bias wanders slowly while matches err from frame to frame, and err most where few walls are seen. So what is known
of the bias counts by its variance, and what a match says of it by the match's (a Kalman filter of one state).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

BIAS_UNKNOWN = 0.05
"""rad/s, standard deviation of a bias of which nothing is known"""
BIAS_WALK = 1e-4
"""rad/s per root of a second that a bias wanders: 0.06 degrees per second in 100 s"""
BIAS_LIMIT = 0.2
"""rad/s; more is no bias but a wrong match"""
SCALE_SIGMA = 0.02
"""share by which gyros err in turning"""


class Gyro:
    """One robot's gyro: what has been learned of its bias."""

    def __init__(self) -> None:
        self.bias = 0.0
        """rad/s"""
        self.variance = BIAS_UNKNOWN**2
        """(rad/s)^2, of the bias"""

    def turned(self, samples: NDArray[np.float64], start: float, end: float) -> float:
        """Rotation from `start` to `end` s by samples (k, ..) of stamps and rates, rad."""
        stamps, rates = samples[:, 0], samples[:, 1]
        low, high = min(start, end), max(start, end)
        knots = np.concatenate([[low], stamps[(stamps > low) & (stamps < high)], [high]])
        area = float(np.trapezoid(np.interp(knots, stamps, rates) - self.bias, knots))
        return area if end >= start else -area

    def sigma(self, turned: float, seconds: float) -> float:
        """Standard deviation of a rotation of `turned` rad in `seconds`, rad."""
        return SCALE_SIGMA * abs(turned) + float(np.sqrt(self.variance)) * seconds

    def learn(self, error: float, seconds: float, sigma: float) -> None:
        """Tell by how many rad in `seconds` > 0 the gyro said more than matching, whose headings err by `sigma` rad."""
        self.variance += BIAS_WALK**2 * seconds
        gain = self.variance / (self.variance + 2.0 * (sigma / seconds) ** 2)  # two headings err
        self.bias = float(np.clip(self.bias + gain * error / seconds, -BIAS_LIMIT, BIAS_LIMIT))
        self.variance *= 1.0 - gain

    def state(self) -> dict[str, Any]:
        """Everything that the next rotation depends on."""
        return {"bias": self.bias, "variance": self.variance}

    @classmethod
    def of(cls, state: dict[str, Any]) -> Gyro:
        """The inverse of `state`."""
        self = cls()
        self.bias, self.variance = state["bias"], state["variance"]
        return self
