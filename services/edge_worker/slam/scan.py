"""A frame as a kernel wants it: points in the base frame at the frame's stamp, freed of the motion in the sweep."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.wire import Frame, LaserScan
from services.edge_worker.slam.motion import DeadReckoning

Points = NDArray[np.float32]

KNOTS = 5
"""poses along a sweep between which the motion is taken as linear"""
AT_RANGE_MAX = 1e-3
"""m; a reading this close to range_max met nothing, whatever the driver calls it"""
STAMP_SHARE = {"sweep_start": 0.0, "sweep_middle": 0.5, "sweep_end": 1.0}
NO_POINTS: Points = np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class Scan:
    """One frame's beams in the base frame at the frame's stamp."""

    stamp: float
    """s"""
    motion: NDArray[np.float64]
    """(3,) dead-reckoned motion since the frame before, in that frame's base: m, m, rad"""
    measured: bool
    """odometry measured the motion; False: it is a guess of constant velocity (with the gyro's yaw, if any)"""
    surge: float = 0.0
    """m by which odometry told more than the usual speed"""
    turn_measured: bool = False
    """a gyro measured the rotation"""
    turn_sigma: float = 0.0
    """rad, standard deviation of that"""
    dt: float = 0.0
    """s since the frame before"""
    velocity: NDArray[np.float64] | None = None
    """(3,) guessed, that the sweep was compensated with: m/s, m/s, rad/s; None where it was measured"""
    alternatives: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    """(k, 3) other motions to try where this one leads nowhere"""
    points: Points = field(default_factory=lambda: NO_POINTS)
    """(n, 2) where beams ended, m"""
    beams: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))
    """(n,) index of the beam behind each point: neighbours in it are neighbours in angle"""
    times: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    """(n,) when each point was taken, s from the stamp on; all 0 for an instantaneous sweep"""
    silent: Points = field(default_factory=lambda: NO_POINTS)
    """(m, 2) ends, cut at the clearing range, of beams that met nothing, m"""
    laser: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    """(2,) the laser in the base frame, m"""


class ScanReader:
    """Reads one robot's frames in order; keeps what dead reckoning needs from one to the next."""

    def __init__(self, range_m: float = np.inf, clear_m: float = 0.0) -> None:
        """Points beyond `range_m` are dropped; beams that met nothing (+inf) clear `clear_m` metres, 0 for none."""
        self.range_m = range_m
        self.clear_m = clear_m
        self.reckoning = DeadReckoning()

    def read(self, frame: Frame) -> Scan:
        """The scan of the next frame. A frame without a usable beam gives a scan without points."""
        motion, measured = self.reckoning.advance(frame)
        reckoning, scan = self.reckoning, frame.scan
        read = Scan(
            frame.stamp,
            motion,
            measured,
            reckoning.wheels.surge,
            reckoning.turn_measured,
            reckoning.turn_sigma,
            reckoning.dt,
            None if measured else reckoning.guessed,
            reckoning.alternatives(),
        )
        if scan is None or len(scan.ranges) == 0:
            return read
        start, times, poses = self._sweep(frame, scan)
        ends, beams, silent = project(
            scan.metres().astype(np.float64),
            scan.angle_min,
            scan.angle_increment,
            scan.range_min,
            min(scan.range_max, self.range_m),
            min(scan.range_max, self.clear_m),
            np.array(scan.mount, np.float64),
            start,
            scan.time_increment,
            times,
            poses,
        )
        laser = np.array(scan.mount[:2], np.float64)
        taken = (start + scan.time_increment * beams).astype(np.float32)
        return replace(read, points=ends, beams=beams, times=taken, silent=silent, laser=laser)

    def state(self) -> dict[str, Any]:
        """Everything that the next scan depends on, as msgpack and arrays take it."""
        return self.reckoning.state()

    def restore(self, state: dict[str, Any]) -> None:
        """The inverse of `state`."""
        self.reckoning = DeadReckoning.of(state)

    def _sweep(self, frame: Frame, scan: LaserScan) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Time of beam 0, and knots of the base's motion over the sweep: times and poses from the stamp on."""
        duration = scan.time_increment * (len(scan.ranges) - 1)
        start = -STAMP_SHARE[frame.stamp_at] * duration
        if duration <= 0.0:
            return 0.0, np.zeros(1), np.zeros((1, 3))
        times = start + np.linspace(0.0, duration, KNOTS)
        return start, times, self.reckoning.within(frame.stamp + times)


def unslipped(scan: Scan, slip: NDArray[np.float64]) -> Scan:
    """The scan with its points moved by a correction (3,) to the velocity that they were compensated with."""
    turn = scan.times * slip[2]
    c, s = np.cos(turn), np.sin(turn)
    x = scan.times * slip[0] + c * scan.points[:, 0] - s * scan.points[:, 1]
    y = scan.times * slip[1] + s * scan.points[:, 0] + c * scan.points[:, 1]
    return replace(scan, points=np.stack([x, y], axis=1).astype(np.float32))


@njit(cache=True)
def project(
    ranges: NDArray[np.float64],
    angle_min: float,
    angle_increment: float,
    range_min: float,
    range_max: float,
    clear: float,
    mount: NDArray[np.float64],
    start: float,
    time_increment: float,
    times: NDArray[np.float64],
    poses: NDArray[np.float64],
) -> tuple[Points, NDArray[np.int32], Points]:
    """Beam ends (n, 2) float32 with their beam indices (n,) int32, and the ends (m, 2) of silent beams.

    `ranges` (b,) m; `mount` (3,) the laser in the base frame; beam i was taken `start + i * time_increment` s after
    the stamp; `times` (k,) s and `poses` (k, 3) give the base's motion around the stamp, linear in between.
    Beams outside [range_min, range_max) and NaN are dropped (REP-117).
    """
    beams = len(ranges)
    ends = np.empty((beams, 2), np.float32)
    index = np.empty(beams, np.int32)
    silent = np.empty((beams, 2), np.float32)
    n = m = 0
    for i in range(beams):
        r = ranges[i]
        clears = r == np.inf and clear > 0.0
        if not clears and not (range_min <= r < range_max - AT_RANGE_MAX):
            continue
        if clears:
            r = clear
        a = mount[2] + angle_min + angle_increment * i
        x, y = mount[0] + r * np.cos(a), mount[1] + r * np.sin(a)
        if len(times) > 1:
            x, y = _compensated(x, y, start + time_increment * i, times, poses)
        if clears:
            silent[m, 0], silent[m, 1] = x, y
            m += 1
        else:
            ends[n, 0], ends[n, 1] = x, y
            index[n] = i
            n += 1
    return ends[:n].copy(), index[:n].copy(), silent[:m].copy()


@njit(cache=True)
def _compensated(
    x: float, y: float, time: float, times: NDArray[np.float64], poses: NDArray[np.float64]
) -> tuple[float, float]:
    """A point of the base at `time` in the base at the stamp."""
    knot = 0
    while knot < len(times) - 2 and times[knot + 1] < time:
        knot += 1
    w = (time - times[knot]) / (times[knot + 1] - times[knot])
    theta = poses[knot, 2] + w * (poses[knot + 1, 2] - poses[knot, 2])
    c, s = np.cos(theta), np.sin(theta)
    base_x = poses[knot, 0] + w * (poses[knot + 1, 0] - poses[knot, 0])
    base_y = poses[knot, 1] + w * (poses[knot + 1, 1] - poses[knot, 1])
    return base_x + c * x - s * y, base_y + s * x + c * y
