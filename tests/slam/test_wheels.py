"""Wheels whose faults are learned, and that slip."""

from __future__ import annotations

import numpy as np
import pytest

from services.edge_worker.slam.wheels import Wheels

DT = 0.2


def driving(*speeds: float, dt: float = DT) -> tuple[Wheels, list[float]]:
    """Wheels that told of these speeds, m/s, frame by frame, and the speeds that were believed."""
    wheels, believed = Wheels(), []
    for speed in speeds:
        step = np.array([speed * dt, 0.0, 0.0])
        believed.append(float(step[0] * wheels.watch(step, dt) / dt))
    return wheels, believed


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["ahead", "backwards"])
def test_slip_is_driven_at_the_usual_speed(way: float) -> None:
    steady, slip = [1.0 * way] * 8, [1.7 * way, 2.0 * way, 2.0 * way, 2.0 * way]
    wheels, believed = driving(*steady, *slip)
    assert wheels.slipping
    assert believed[8:] == pytest.approx([way] * 4)
    assert driving(*steady, *slip, way)[1][-1] == pytest.approx(way)


@pytest.mark.parametrize("dt", [0.025, 0.0999, 0.18], ids=["40 Hz", "10 Hz", "5.5 Hz"])
def test_a_slip_of_a_second_is_not_how_fast_the_robot_goes_whatever_the_laser_s_rate(dt: float) -> None:
    slip = round(0.9 / dt)
    believed = driving(*[1.0] * round(4 / dt), *[2.0] * slip, dt=dt)[1][-slip:]
    assert sum(believed) * dt == pytest.approx(slip * dt, abs=0.06)


def test_a_sweep_within_a_slip_is_believed_as_little() -> None:
    wheels, _ = driving(*[1.0] * 8)
    assert wheels.believed(np.array([0.4, 0.0, 0.0]), DT) == pytest.approx(0.5)
    assert wheels.believed(np.array([0.24, 0.0, 0.0]), DT) == 1.0


def test_a_robot_that_speeds_up_or_sets_out_is_believed() -> None:
    faster = list(np.minimum(0.5 + 0.3 * np.arange(10), 2.0))
    assert driving(*[0.5] * 8, *faster)[1][8:] == pytest.approx(faster)
    assert driving(*[0.0] * 8, 0.5, 0.5)[1][8:] == [0.5, 0.5]


def test_stamps_that_bunch_are_no_slip() -> None:
    """The frame before came late, so that this one seems twice as fast: together they are as fast as ever."""
    wheels, _ = driving(*[1.0] * 8)
    wheels.watch(np.array([0.2, 0.0, 0.0]), 0.3)
    assert wheels.watch(np.array([0.2, 0.0, 0.0]), 0.1) == pytest.approx(1.0)
    assert wheels.surge < 1e-9


def test_a_frame_that_tells_no_speed_ends_a_slip() -> None:
    wheels, _ = driving(*[1.0] * 8, 2.0)
    wheels.unwatched()
    assert not wheels.slipping
    assert wheels.surge == 0.0


def learned(*frames: tuple[float, float]) -> float:
    """The scale after frames, 100 times over, of which odometry told and matching found so many metres."""
    wheels = Wheels()
    for told, matched in frames * 100:
        wheels.watch(np.array([told, 0.0, 0.0]), DT)
        wheels.learn(np.array([matched, 0.0, 0.0]), np.array([told, 0.0, 0.0]))
    return wheels.scale


def test_the_scale_is_learned_though_odometry_is_noisy() -> None:
    assert learned((0.18, 0.19), (0.22, 0.19)) == pytest.approx(0.95, abs=3e-3)


def test_the_scale_is_learned_from_steps_that_are_too_short_by_themselves() -> None:
    assert learned(*[(0.008, 0.0076)] * 12) == pytest.approx(0.95, abs=0.01)


def test_the_scale_is_not_learned_from_slip_nor_from_its_beginning_and_end() -> None:
    steady, slip = [(0.2, 0.19)] * 9, [(0.22, 0.19), (0.4, 0.19), (0.4, 0.19), (0.22, 0.19)]
    assert learned(*steady, *slip) == pytest.approx(0.95, abs=3e-3)


def test_a_state_is_taken_over_whole() -> None:
    wheels, _ = driving(*[1.0] * 8, 2.0)
    assert vars(Wheels.of(wheels.state())).keys() == vars(wheels).keys()
    step = np.array([0.4, 0.0, 0.0])
    assert Wheels.of(wheels.state()).watch(step, DT) == wheels.watch(step, DT)
