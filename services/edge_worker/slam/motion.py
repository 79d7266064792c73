"""Dead reckoning: what odometry, gyro or, for want of both, the latest velocity say about the motion.

Translation comes from odometry where samples cover the time, else from the velocity that the kernel last found;
yaw comes from the gyro less its estimated bias where there is one, else from the same source as translation.
What is wrong with the wheels is learned from the matched motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose, interpolate, wrap
from common.wire import Frame
from services.edge_worker.slam.gyro import Gyro
from services.edge_worker.slam.wheels import SPEED_BASE_S, Wheels

Samples = NDArray[np.float64]

NO_SAMPLES: Samples = np.empty((0, 4))
COVER_S = 0.25
"""samples this far from a time still cover it"""
COAST_S = 0.6
"""a velocity says nothing about times further off than this"""
MAX_SPEED = 3.0
"""m/s; what goes faster is a bunched stamp or an odometry that was reset"""
MAX_TURN = 4.0
"""rad/s"""
JUMP_M = 1.0
"""m by which odometry may break that limit between two frames, whatever their stamps"""
LONGEST_S = 60.0
"""s; no gap between frames excuses more motion than this one"""
HISTORY = 8
"""frames over which odometry may have stalled and then catches up"""
HEADING_SIGMA = 0.005
"""rad, of a match that does not say how well it knows the heading"""
AHEAD_S = 60.0
"""samples later than this after their frame's stamp are of another clock: in order with them, no later one would be"""
FARTHEST_M, MOST_TURNED = 1e8, 1e6
"""m, rad; odometry that tells of more is nonsense"""
GYRO_LIMIT = 35.0
"""rad/s, what the usual ones can say; more is nonsense"""


class DeadReckoning:
    """Motion of one robot between the stamps of its frames, and within a sweep."""

    def __init__(self) -> None:
        self.stamp: float | None = None
        """s, of the frame before"""
        self.odometry = NO_SAMPLES
        self.imu = NO_SAMPLES
        self.velocity = np.zeros(3)
        """m/s, m/s, rad/s in the base frame, from the matched motion"""
        self.gyro = Gyro()
        self.wheels = Wheels()
        self.firm = False
        """the latest frame's match held it along its motion"""
        self.at: NDArray[np.float64] | None = None
        """(3,) the odometry's pose at that frame; None where it had none"""
        self.history = np.empty((0, 6))
        """(k, 6) of the latest frames: where odometry was at the frame before each, and the motion taken since"""
        self.guessed = self.velocity
        """the velocity when the latest frame came"""
        self.dt = 0.0
        """s between the latest two frames"""
        self._gyro_yaw: float | None = None
        self._was_at: NDArray[np.float64] | None = None

    def advance(self, frame: Frame) -> tuple[NDArray[np.float64], bool]:
        """The motion (3,) since the frame before, in that frame's base, and whether odometry measured it.

        Stamps may bunch or step back: odometry that has a sample at the frame's stamp is right all the same.
        """
        before, now = self.stamp, frame.stamp
        was_at = self._was_at = self.at
        self.guessed = self.velocity
        if before is None or now < before:
            self.odometry = self.imu = NO_SAMPLES
        start = now if before is None else min(before, now)
        self.odometry = _extend(self.odometry, _credible(frame.odometry), start, now + AHEAD_S)
        self.imu = _extend(self.imu, _sane(frame.imu), start, now + AHEAD_S)
        self.stamp, self.dt = now, (0.0 if before is None else now - before)
        self.at = _pose_at(self.odometry, now)
        self._gyro_yaw = None
        if before is None:
            return np.zeros(3), False
        motion = self._coasted() if self.at is None or was_at is None else self.wheels.scaled(between(was_at, self.at))
        measured = self.at is not None and was_at is not None
        if measured and not np.hypot(motion[0], motion[1]) <= _reach(self.dt):
            motion, measured = self._coasted(), False
        if measured and 0.0 < self.dt <= COAST_S:
            motion[:2] *= self.wheels.watch(motion, self.dt)
        else:
            self.wheels.unwatched()
        if self.dt > 0.0 and _covers(self.imu, before, now):
            yaw = self._gyro_yaw = self.gyro.turned(self.imu, before, now)
            motion = compose(np.array([0.0, 0.0, (yaw - motion[2]) / 2]), motion)
            motion[2] = wrap(yaw)
        return motion, measured

    @property
    def turn_measured(self) -> bool:
        """A gyro measured the rotation since the frame before."""
        return self._gyro_yaw is not None

    @property
    def turn_sigma(self) -> float:
        """Standard deviation of that, rad."""
        return self.gyro.sigma(self._gyro_yaw or 0.0, max(self.dt, 0.0))

    def within(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (k, 3) of the base at `times` (k,) seconds near the last stamp, in the base at that stamp."""
        assert self.stamp is not None
        if _covers(self.odometry, self.stamp, self.stamp):
            track = _coasting(self.odometry)
            poses = interpolate(track[:, 0], track[:, 1:], np.append(times, self.stamp))
            poses = self.wheels.scaled(between(poses[-1], poses[:-1]))
            furthest = int(np.argmax(np.abs(times - self.stamp)))
            seconds = abs(float(times[furthest]) - self.stamp)
            if seconds >= SPEED_BASE_S:
                poses[:, :2] *= self.wheels.believed(poses[furthest], seconds)
        else:
            poses = np.clip(times - self.stamp, -COAST_S, COAST_S)[:, None] * self.velocity
        if self._gyro_yaw is not None:
            poses[:, 2] = [self.gyro.turned(self.imu, self.stamp, time) for time in times]
        near = np.hypot(poses[:, 0], poses[:, 1]) <= JUMP_M + MAX_SPEED * np.abs(times - self.stamp)
        return poses if near.all() else np.zeros_like(poses)

    def alternatives(self) -> NDArray[np.float64]:
        """Other motions (k, 3) that are worth a try: going on as before, and odometry catching up after a stall."""
        others = [self._coasted()] if 0.0 < self.dt <= COAST_S else []
        if len(self.history) and self.at is not None:
            travelled = self.history[0, 3:]
            for motion in self.history[1:, 3:]:
                travelled = compose(travelled, motion)
            others.append(between(travelled, self.wheels.scaled(between(self.history[0, :3], self.at))))
        near = [motion for motion in others if np.hypot(motion[0], motion[1]) <= _reach(HISTORY * self.dt)]
        return np.array(near).reshape(-1, 3)

    def learn(
        self,
        motion: NDArray[np.float64],
        matched: bool = True,
        firm: bool = False,
        heading_sigma: float = HEADING_SIGMA,
    ) -> None:
        """Tell the motion (3,) since the frame before that was settled on, by matching or for want of it; each frame.

        `firm`: the match held the robot along its motion, not odometry; `heading_sigma` rad: how well it held heading.
        """
        if firm and self.firm and self._was_at is not None and self.at is not None:
            self.wheels.learn(motion, between(self._was_at, self.at))
        self.firm = firm
        if self._was_at is None or self.at is None:
            self.history = self.history[:0]
        else:
            self.history = np.vstack([self.history[1 - HISTORY :], np.concatenate([self._was_at, motion])])
        if self.dt <= 0.0:
            return
        self._take(motion / self.dt if matched and self.dt <= 2 * COAST_S else np.zeros(3))
        if self._gyro_yaw is not None and matched:
            self.gyro.learn(float(wrap(self._gyro_yaw - motion[2])), self.dt, heading_sigma)

    def slipped(self, slip: NDArray[np.float64]) -> None:
        """Correct the velocity, after `learn`, by what matching found that it was off by during the sweep."""
        velocity = self.guessed + slip
        self._take(velocity if self._gyro_yaw is None else np.append(velocity[:2], self.velocity[2]))

    def state(self) -> dict[str, Any]:
        """Everything that the next frame depends on, as msgpack and arrays take it."""
        return {
            "stamp": self.stamp,
            "wheels": self.wheels.state(),
            "firm": self.firm,
            "at": self.at,
            "history": self.history,
            "odometry": self.odometry,
            "imu": self.imu,
            "velocity": self.velocity,
            "gyro": self.gyro.state(),
        }

    @classmethod
    def of(cls, state: dict[str, Any]) -> DeadReckoning:
        """The inverse of `state`."""
        self = cls()
        self.stamp, self.gyro = state["stamp"], Gyro.of(state["gyro"])
        self.wheels, self.firm = Wheels.of(state["wheels"]), state["firm"]
        self.at, self.history = state["at"], state["history"]
        self.odometry, self.imu, self.velocity = state["odometry"], state["imu"], state["velocity"]
        return self

    def _take(self, velocity: NDArray[np.float64]) -> None:
        """Believe a velocity (3,), but not one that no robot has: that comes of bunched stamps or a wrong match."""
        fair = np.hypot(velocity[0], velocity[1]) <= MAX_SPEED and abs(velocity[2]) <= MAX_TURN
        self.velocity = velocity if fair else np.zeros(3)

    def _coasted(self) -> NDArray[np.float64]:
        """The motion (3,) since the frame before if the velocity went on; none across a pause."""
        return self.velocity * self.dt if 0.0 < self.dt <= COAST_S else np.zeros(3)


def _reach(seconds: float) -> float:
    """m that odometry may tell of in so long a time."""
    return JUMP_M + MAX_SPEED * min(max(seconds, 0.0), LONGEST_S)


def _sane(imu: Samples | None) -> Samples | None:
    """Samples whose rate a gyro can have."""
    return imu if imu is None else imu[np.abs(imu[:, 1]) <= GYRO_LIMIT]


def _credible(odometry: Samples | None) -> Samples | None:
    """Samples of where a robot can be."""
    limits = (FARTHEST_M, FARTHEST_M, MOST_TURNED)
    return odometry if odometry is None else odometry[(np.abs(odometry[:, 1:]) <= limits).all(axis=1)]


def _extend(old: Samples, new: Samples | None, start: float, end: float) -> Samples:
    """Samples with rising stamps up to `end`, the last of equal ones, cut so that one at or before `start` is left."""
    new = NO_SAMPLES if new is None else new[np.isfinite(new).all(axis=1) & (new[:, 0] <= end)]
    if len(new):
        joined = np.concatenate([old, new]) if len(old) else new
        ordered = joined[joined[:, 0] >= np.maximum.accumulate(joined[:, 0])]
        old = ordered[np.append(ordered[1:, 0] > ordered[:-1, 0], True)]
    keep = max(int(np.searchsorted(old[:, 0], start - SPEED_BASE_S, side="right")) - 1, 0)
    return old[keep:]


def _pose_at(odometry: Samples, stamp: float) -> NDArray[np.float64] | None:
    """The odometry's pose (3,) at `stamp`, by a sample at it or by samples around it; None where there are none."""
    if not len(odometry):
        return None
    exact = int(np.searchsorted(odometry[:, 0], stamp))
    if exact < len(odometry) and odometry[exact, 0] == stamp:
        return odometry[exact, 1:].copy()
    if not _covers(odometry, stamp, stamp):
        return None
    track = _coasting(odometry)
    return interpolate(track[:, 0], track[:, 1:], np.array([stamp]))[0]


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
