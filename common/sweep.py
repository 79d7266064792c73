"""A sweep is what a source of sensor data yields, before it is packed into a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.wire.base import PoseTuple


@dataclass(frozen=True)
class LaserGeometry:
    """How a laser sees: beam i points at `angle_min + i * angle_increment` in the laser's own frame."""

    angle_min: float
    """rad"""
    angle_increment: float
    """rad, negative for a laser that turns clockwise"""
    range_min: float
    """m"""
    range_max: float
    """m"""
    time_increment: float = 0.0
    """s between beams, 0 for an instantaneous sweep"""
    mount: PoseTuple = (0.0, 0.0, 0.0)
    """pose of the laser in the robot's base frame (m, m, rad)"""


@dataclass(frozen=True)
class Sweep:
    """One turn of a laser with the odometry and IMU samples since the sweep before."""

    stamp: float
    """s, when the first beam was taken"""
    geometry: LaserGeometry
    ranges: NDArray[np.float32]
    """(n,) m; NaN invalid, +inf nothing in range, -inf too close (REP-117)"""
    odometry: NDArray[np.float64] | None = None
    """(k, 4): stamp s, x m, y m, theta rad in the odometry frame, stamps rising"""
    imu: NDArray[np.float64] | None = None
    """(k, 4): stamp s, yaw rate rad/s, acceleration x and y m/s^2 in the base frame"""
