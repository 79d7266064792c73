"""What a gyro's bias is learned from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from services.edge_worker.slam.gyro import BIAS_LIMIT, Gyro

DT = 0.2
SURE, BLIND = 0.003, 0.1
"""rad, headings of a scan of many walls, and of one that shows hardly any"""


def rates(bias: float, seconds: float = 1.0, turning: float = 0.0) -> NDArray[np.float64]:
    """Samples (k, 2) of a gyro at 50 Hz."""
    stamps = np.arange(0.0, seconds + 0.01, 0.02)
    return np.column_stack([stamps, np.full(len(stamps), turning + bias)])


def learned(biases: NDArray[np.float64], sigma: float, gyro: Gyro | None = None) -> Gyro:
    """A gyro told, frame by frame, what its bias seems to be by matching, rad/s."""
    gyro = gyro or Gyro()
    for bias in biases:
        gyro.learn((bias - gyro.bias) * DT, DT, sigma)
    return gyro


def test_a_bias_is_learned_within_seconds_and_taken_off() -> None:
    noise = np.random.default_rng(1).normal(0.0, 2**0.5 * SURE / DT, 50)
    gyro = learned(0.03 + noise, SURE)
    assert gyro.bias == pytest.approx(0.03, abs=0.008)
    assert gyro.turned(rates(0.03, turning=0.5), 0.0, 1.0) == pytest.approx(0.5, abs=0.008)
    assert gyro.turned(rates(0.03, turning=0.5), 1.0, 0.0) == pytest.approx(-0.5, abs=0.008)


def test_scans_of_hardly_any_walls_do_not_lead_a_known_bias_astray() -> None:
    gyro = learned(np.full(500, 0.01), SURE)
    astray = learned(np.full(50, 0.01 + 0.05), BLIND, gyro)
    assert astray.bias == pytest.approx(0.01, abs=0.002)


def test_a_bias_that_has_wandered_is_learned_anew() -> None:
    gyro = learned(np.full(2000, 0.02), SURE, learned(np.full(2000, 0.01), SURE))
    assert gyro.bias == pytest.approx(0.02, abs=0.001)


def test_rotations_are_surer_the_longer_a_gyro_has_been_watched() -> None:
    before, after = Gyro(), learned(np.zeros(500), SURE)
    assert after.sigma(0.0, 1.0) < before.sigma(0.0, 1.0) / 10
    assert after.sigma(1.0, 1.0) > after.sigma(0.0, 1.0) + 0.01


def test_wrong_matches_do_not_make_a_bias_of_nonsense() -> None:
    assert abs(learned(np.full(50, 5.0), SURE).bias) <= BIAS_LIMIT


def test_a_gyro_goes_on_as_it_was_after_a_restore() -> None:
    gyro = learned(np.full(50, 0.03), SURE)
    again = learned(np.full(5, 0.02), SURE, Gyro.of(gyro.state()))
    assert again.state() == learned(np.full(5, 0.02), SURE, gyro).state()
