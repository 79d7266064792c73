"""Wheels and IMU report the true motion with the errors that their settings name, and no others."""

import numpy as np
import pytest

from common.errors import ConfigError
from common.geometry import between, wrap
from common.sim.motion import Pace
from common.sim.odometry import PRESETS, imu, preset, wheel_odometry
from common.sim.scene import load_scene

TRACK = load_scene("apartment").track("r1", 0, Pace())
UNTIL = TRACK.duration


def drift(name: str, seed: int) -> float:
    """Error in metres at the end, having started right."""
    rows = wheel_odometry(TRACK, UNTIL, PRESETS[name], np.random.default_rng(seed))
    true = between(TRACK.at([0.0])[0], TRACK.at(rows[-1:, 0])[0])
    return float(np.hypot(*(rows[-1, 1:3] - true[:2])))


def test_without_noise_odometry_is_the_motion_since_the_start() -> None:
    rows = wheel_odometry(TRACK, UNTIL, PRESETS["none"], np.random.default_rng(0))
    np.testing.assert_array_equal(rows[0], np.zeros(4))
    true = between(TRACK.at([0.0]), TRACK.at(rows[:, 0]))
    np.testing.assert_allclose(rows[:, 1:3], true[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(rows[:, 3] - true[:, 2]), 0, atol=1e-9)


def test_samples_come_at_their_rates() -> None:
    noise = PRESETS["good"]
    wheels = wheel_odometry(TRACK, UNTIL, noise, np.random.default_rng(0))
    inertial = imu(TRACK, UNTIL, noise, np.random.default_rng(0))
    np.testing.assert_allclose(np.diff(wheels[:, 0]), 1 / noise.wheel_hz)
    np.testing.assert_allclose(np.diff(inertial[:, 0]), 1 / noise.imu_hz)


def test_worse_wheels_drift_farther() -> None:
    good, worn, slippery = (np.mean([drift(name, seed) for seed in range(20)]) for name in ("good", "worn", "slippery"))
    assert 0.1 < good < 2.0 < slippery < 10.0
    assert good < worn < slippery


def test_slip_makes_the_wheels_run_ahead_of_the_robot() -> None:
    noise = PRESETS["none"].__class__(**{**vars(PRESETS["none"]), "slips_per_min": 6.0, "slip": 0.5})
    rows = wheel_odometry(TRACK, UNTIL, noise, np.random.default_rng(4))
    true = np.hypot(*np.diff(TRACK.at(rows[:, 0])[:, :2], axis=0).T)
    told = np.hypot(*np.diff(rows[:, 1:3], axis=0).T)
    ratio = told[true > 1e-4] / true[true > 1e-4]
    assert set(np.round(ratio, 6)) == {1.0, 2.0}
    assert (ratio > 1.5).mean() < 0.2


def test_the_gyro_integrates_to_the_turn_and_its_bias() -> None:
    clean = imu(TRACK, UNTIL, PRESETS["none"], np.random.default_rng(0))
    turned = TRACK.turned([clean[-1, 0]])[0, 2] - TRACK.turned([0.0])[0, 2]
    assert np.sum(clean[:, 1]) / 50 == pytest.approx(turned, abs=0.01)
    noisy = imu(TRACK, UNTIL, PRESETS["good"], np.random.default_rng(0))
    bias = (noisy - clean)[:, 1]
    assert 0 < abs(bias.mean()) < 4 * PRESETS["good"].gyro_bias
    assert bias.std() == pytest.approx(PRESETS["good"].gyro_noise, rel=0.1)


def test_acceleration_integrates_to_the_speed_in_the_base_frame() -> None:
    clean = imu(TRACK, UNTIL, PRESETS["none"], np.random.default_rng(0))
    speed = np.cumsum(clean[:, 2]) / 50
    poses = TRACK.turned(clean[:, 0])
    true = np.hypot(*np.diff(poses[:, :2], axis=0).T) * 50
    assert np.abs(speed[1:] - true).max() < 0.05
    assert np.abs(clean[:, 3]).max() < 1e-3  # on straights and on the spot nothing pulls sideways


def test_unknown_noise_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"bumpy.*slippery"):
        preset("bumpy")
