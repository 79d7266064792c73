"""Wheel odometry and an IMU: a track as a robot's own sensors would report it.

Wheels err by a scale, a yaw that grows with the distance, noise per increment, and now and then by slip: for a
short while they turn without carrying the robot as far. A gyro has a bias and noise. How wrong one robot's
sensors are is drawn once per robot from the generator, so a fleet's robots all err differently.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.geometry import between, compose, wrap
from common.sim.track import Track

SLIP_S = 0.6
"""s that one slip lasts"""


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of what is drawn per robot and per sample."""

    wheel_hz: float = 20.0
    imu_hz: float = 50.0
    scale: float = 0.01
    """share by which one robot's wheels err in distance"""
    turn_scale: float = 0.015
    """share by which they err in turning"""
    yaw_per_m: float = 0.003
    """rad of one robot's drift per metre"""
    distance_noise: float = 0.02
    """m per square root of a metre driven"""
    yaw_noise: float = 0.02
    """rad per square root of a radian turned"""
    yaw_noise_per_m: float = 0.006
    """rad per square root of a metre driven"""
    slips_per_min: float = 0.0
    slip: float = 0.3
    """share of the wheels' way that is lost while slipping"""
    gyro_bias: float = 0.003
    """rad/s"""
    gyro_noise: float = 0.004
    """rad/s per sample"""
    acceleration_noise: float = 0.05
    """m/s^2 per sample"""


PRESETS: dict[str, OdometryNoise] = {
    "none": OdometryNoise(20.0, 50.0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    "good": OdometryNoise(),
    "worn": OdometryNoise(
        scale=0.03, turn_scale=0.04, yaw_per_m=0.01, distance_noise=0.04, yaw_noise=0.04, yaw_noise_per_m=0.015
    ),
    "slippery": OdometryNoise(
        scale=0.03, turn_scale=0.04, yaw_per_m=0.01, distance_noise=0.04, yaw_noise=0.05, yaw_noise_per_m=0.02,
        slips_per_min=8.0, slip=0.5,
        gyro_bias=0.006,
    ),
    "hostile": OdometryNoise(
        scale=0.05, turn_scale=0.05, yaw_per_m=0.01, distance_noise=0.05, yaw_noise=0.05, yaw_noise_per_m=0.02,
        slips_per_min=6.0, slip=0.5,
        gyro_bias=0.01, gyro_noise=0.01,
    ),
}  # fmt: skip


def preset(name: str) -> OdometryNoise:
    """Named settings. Raises ConfigError naming those that there are."""
    if name not in PRESETS:
        raise ConfigError(f"noise: nothing is called {name!r}; there are: {', '.join(PRESETS)}")
    return PRESETS[name]


def wheel_odometry(track: Track, until: float, noise: OdometryNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """Samples (n, 4): stamp s, x m, y m, theta rad in the odometry frame, which starts at (0, 0, 0) at time 0."""
    stamps = np.arange(int(until * noise.wheel_hz) + 1) / noise.wheel_hz
    poses = track.at(stamps)
    steps = between(poses[:-1], poses[1:])
    scale, turn_scale, drift = rng.normal(size=3) * [noise.scale, noise.turn_scale, noise.yaw_per_m]
    draws = rng.normal(size=(len(steps), 2))
    distance, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    wheels = 1.0 + scale + _slipping(stamps[1:], noise, rng) * noise.slip / max(1e-9, 1.0 - noise.slip)
    rolled = np.divide(distance + np.sqrt(distance) * noise.distance_noise * draws[:, 0], distance,
                       out=np.ones_like(distance), where=distance > 0)  # fmt: skip
    steps[:, :2] *= (wheels * rolled)[:, None]
    spread = np.hypot(np.sqrt(turn) * noise.yaw_noise, np.sqrt(distance) * noise.yaw_noise_per_m)
    steps[:, 2] = steps[:, 2] * (1 + turn_scale) + distance * drift + spread * draws[:, 1]
    return np.column_stack([stamps, _chained(steps)])


def _slipping(stamps: NDArray[np.float64], noise: OdometryNoise, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which samples (n,) fall into a slip."""
    count = rng.poisson(noise.slips_per_min * (stamps[-1] if len(stamps) else 0.0) / 60.0)
    begins = rng.uniform(0, stamps[-1], size=count) if count else np.empty(0)
    during = (stamps[:, None] >= begins) & (stamps[:, None] < begins + SLIP_S)
    return np.asarray(during.any(axis=1))


def _chained(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (n + 1, 3) from the origin along steps (n, 3), each given in the frame of the pose before it."""
    theta = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    heading = np.column_stack([np.zeros((len(steps), 2)), theta[:-1]])
    moved = compose(heading, steps)[:, :2]
    return np.column_stack([np.vstack([np.zeros(2), np.cumsum(moved, axis=0)]), wrap(theta)])


def imu(track: Track, until: float, noise: OdometryNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """Samples (n, 4): stamp s, yaw rate rad/s, acceleration x and y m/s^2 in the base frame."""
    half = 1.0 / noise.imu_hz
    stamps = np.arange(int(until * noise.imu_hz) + 1) / noise.imu_hz
    before, here, after = (track.turned(stamps + offset) for offset in (-half, 0.0, half))
    rate = (after[:, 2] - before[:, 2]) / (2 * half)
    pull = (after[:, :2] - 2 * here[:, :2] + before[:, :2]) / half**2
    c, s = np.cos(here[:, 2]), np.sin(here[:, 2])
    bias = rng.normal() * noise.gyro_bias
    draws = rng.normal(size=(len(stamps), 3)) * [noise.gyro_noise, *[noise.acceleration_noise] * 2]
    rate += bias + draws[:, 0]
    return np.column_stack(
        [stamps, rate, c * pull[:, 0] + s * pull[:, 1] + draws[:, 1], c * pull[:, 1] - s * pull[:, 0] + draws[:, 2]]
    )
