"""Dead reckoning: what odometry, gyro or, for want of both, the latest velocity say about the motion.

Translation comes from odometry where samples cover the time, else from the velocity that the kernel last found;
yaw comes from the gyro less its estimated bias where there is one, else from the same source as translation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose, interpolate, wrap
from common.wire import Frame

Samples = NDArray[np.float64]

NO_SAMPLES: Samples = np.empty((0, 4))
COVER_S = 0.25
"""samples this far from a time still cover it"""
COAST_S = 0.6
"""a velocity says nothing about times further off than this"""
SPEED_BASE_S = 0.1
"""samples closer than this give no velocity: their stamps jitter"""
BIAS_MEMORY_S = 20.0
"""the gyro's bias follows the matched rotation with this time constant"""
BIAS_LIMIT = 0.2
"""rad/s; more is no bias but a wrong match"""


class DeadReckoning:
    """Motion of one robot between the stamps of its frames, and within a sweep."""

    def __init__(self) -> None:
        self.stamp: float | None = None
        """s, of the frame before"""
        self.odometry = NO_SAMPLES
        self.imu = NO_SAMPLES
        self.velocity = np.zeros(3)
        """m/s, m/s, rad/s in the base frame, from the matched motion"""
        self.bias = 0.0
        """rad/s"""
        self.bias_age = 0.0
        """s of motion that the bias was learned from"""
        self._dt = 0.0
        self._gyro_yaw: float | None = None

    def advance(self, frame: Frame) -> tuple[NDArray[np.float64], bool]:
        """The motion (3,) since the frame before, in that frame's base, and whether odometry measured it."""
        before, now = self.stamp, frame.stamp
        if before is None or now < before:
            self.odometry = self.imu = NO_SAMPLES
        start = now if before is None else min(before, now)
        self.odometry = _extend(self.odometry, frame.odometry, start)
        self.imu = _extend(self.imu, frame.imu, start)
        self.stamp, self._dt = now, (0.0 if before is None else now - before)
        self._gyro_yaw = None
        if before is None or self._dt <= 0.0:
            return np.zeros(3), False
        return self._between(before, now)

    def within(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (k, 3) of the base at `times` (k,) seconds near the last stamp, in the base at that stamp."""
        assert self.stamp is not None
        if _covers(self.odometry, self.stamp, self.stamp):
            track = _coasting(self.odometry)
            poses = interpolate(track[:, 0], track[:, 1:], np.append(times, self.stamp))
            poses = between(poses[-1], poses[:-1])
        else:
            poses = np.clip(times - self.stamp, -COAST_S, COAST_S)[:, None] * self.velocity
        if _covers(self.imu, self.stamp, self.stamp):
            poses[:, 2] = [self._yaw(self.stamp, time) for time in times]
        return poses

    def learn(self, motion: NDArray[np.float64]) -> None:
        """Take the matched motion (3,) since the frame before: the velocity, and what the gyro was off by."""
        if self._dt <= 0.0:
            return
        self.velocity = motion / self._dt if self._dt <= COAST_S * 2 else np.zeros(3)
        if self._gyro_yaw is None:
            return
        error = float(wrap(self._gyro_yaw - motion[2])) / self._dt
        self.bias_age = min(self.bias_age + self._dt, BIAS_MEMORY_S)
        gain = min(self._dt / max(self.bias_age, 1.0), 1.0)
        self.bias = float(np.clip(self.bias + gain * error, -BIAS_LIMIT, BIAS_LIMIT))

    def state(self) -> dict[str, Any]:
        """Everything that the next frame depends on, as msgpack and arrays take it."""
        return {
            "stamp": self.stamp,
            "odometry": self.odometry,
            "imu": self.imu,
            "velocity": self.velocity,
            "bias": self.bias,
            "bias_age": self.bias_age,
        }

    @classmethod
    def of(cls, state: dict[str, Any]) -> DeadReckoning:
        """The inverse of `state`."""
        self = cls()
        self.stamp, self.bias, self.bias_age = state["stamp"], state["bias"], state["bias_age"]
        self.odometry, self.imu, self.velocity = state["odometry"], state["imu"], state["velocity"]
        return self

    def _between(self, before: float, now: float) -> tuple[NDArray[np.float64], bool]:
        measured = _covers(self.odometry, before, now)
        if measured:
            track = _coasting(self.odometry)
            poses = interpolate(track[:, 0], track[:, 1:], np.array([before, now]))
            motion = between(poses[0], poses[1])
        else:
            motion = self.velocity * self._dt if self._dt <= COAST_S else np.zeros(3)
        if _covers(self.imu, before, now):
            yaw = self._yaw(before, now)
            self._gyro_yaw = yaw
            half = np.array([0.0, 0.0, (yaw - motion[2]) / 2])
            motion = compose(half, motion)
            motion[2] = wrap(yaw)
        return motion, measured

    def _yaw(self, start: float, end: float) -> float:
        """The gyro's rotation from `start` to `end`, bias taken off, rad."""
        stamps, rates = self.imu[:, 0], self.imu[:, 1]
        low, high = min(start, end), max(start, end)
        inner = stamps[(stamps > low) & (stamps < high)]
        knots = np.concatenate([[low], inner, [high]])
        area = float(np.trapezoid(np.interp(knots, stamps, rates) - self.bias, knots))
        return area if end >= start else -area


def _extend(old: Samples, new: Samples | None, start: float) -> Samples:
    """Samples with rising stamps, cut so that one at or before `start` is still among them."""
    if new is not None and len(new):
        new = new[np.isfinite(new).all(axis=1)]
        joined = np.concatenate([old, new]) if len(old) else new
        rising = joined[:, 0] > np.concatenate([[-np.inf], np.maximum.accumulate(joined[:-1, 0])])
        old = joined[rising]
    keep = max(int(np.searchsorted(old[:, 0], start - SPEED_BASE_S, side="right")) - 1, 0)
    return old[keep:]


def _covers(samples: Samples, start: float, end: float) -> bool:
    return len(samples) > 1 and bool(samples[0, 0] <= start + COVER_S and samples[-1, 0] >= end - COVER_S)


def _coasting(track: Samples) -> Samples:
    """The track with one more sample at its end, where the latest velocity leads."""
    then = int(np.searchsorted(track[:, 0], track[-1, 0] - SPEED_BASE_S, side="right")) - 1
    then = max(then, 0)
    dt = track[-1, 0] - track[then, 0]
    if dt <= 0.0 or dt > COAST_S * 2:
        return track
    step = between(track[then, 1:], track[-1, 1:]) * (COVER_S / dt)
    return np.vstack([track, np.append(track[-1, 0] + COVER_S, compose(track[-1, 1:], step))])
