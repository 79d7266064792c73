"""Lasers whose beams are dense for their noise: neighbouring beams alone do not show a wall's direction."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import run

from common.geometry import between
from common.sim import SimulatedRobot
from common.sim.scene import Scene
from common.sim.world import Plan
from services.edge_worker.slam.graph.keyframe import normals
from services.robot_agent.packing import pack


def test_normals_of_dense_noisy_beams_stand_on_the_wall_all_the_same() -> None:
    """A laser of 0.35 degrees that errs by a hundredth, between two walls 1.2 m apart."""
    rng = np.random.default_rng(1)
    angles = np.radians(np.arange(-120.0, 120.0, 0.35))
    ranges = np.minimum(0.6 / np.maximum(np.abs(np.sin(angles)), 1e-9), 5.6)
    wall = ranges < 5.6
    noisy = ranges * (1 + 0.01 * rng.standard_normal(len(angles)))
    points = (noisy[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))[wall].astype(np.float32)
    found = normals(points, np.flatnonzero(wall).astype(np.int32), np.zeros(2))
    stand = (found != 0).any(axis=1)
    assert stand.mean() > 0.9
    assert np.sqrt(np.square(found[stand, 0]).mean()) < 0.1


def test_dense_noisy_beams_do_not_hold_a_robot_back_in_a_corridor() -> None:
    """1.2 m wide, no end in sight: only the wheels tell how far the robot went."""
    plan = Plan()
    plan.room(0.0, -0.6, 24.0, 0.6)
    scene = Scene("corridor", plan.world(), (7.0, 0.0), {"along": np.array([[7.0, 0.0], [17.0, 0.0]])})
    driver = SimulatedRobot(scene, "r1", 1, lidar="urg04lx", route="along", noise="none", imu=False)
    kernel = run([pack(sweep, "r1", "0" * 32, seq) for seq, sweep in enumerate(driver.sweeps())])
    rows = kernel.trajectory()[[0, -1]]
    (begin, end), (before, after) = driver.poses(rows[:, 0]), rows[:, 1:]
    assert end[0] - begin[0] > 9.0
    assert between(before, after) == pytest.approx(between(begin, end), abs=0.1)
