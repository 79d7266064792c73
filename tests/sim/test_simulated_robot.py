"""A simulated robot's sweeps: repeatable, gapless, honest about time, light to import."""

import subprocess
import sys

import numpy as np
import pytest

from common.geometry import apply, compose
from common.sim import SimulatedRobot, load_scene
from common.sweep import Sweep

SCENE = load_scene("apartment")


def record(**settings: object) -> list[Sweep]:
    return list(SimulatedRobot(SCENE, "r2", 7, **{"duration_s": 30.0, **settings}).sweeps())  # type: ignore[arg-type]


def test_the_same_arguments_give_the_same_sweeps_bit_for_bit() -> None:
    first, second = (record(peers=("r1", "r2", "ann")) for _ in range(2))
    robot = SimulatedRobot(SCENE, "r2", 7, duration_s=30.0, peers={"ann": "", "r1": ""})
    for one, *others in zip(first, second, robot.sweeps(), strict=True):
        for other in others:
            assert one.stamp == other.stamp
            for field in ("ranges", "odometry", "imu"):
                assert getattr(one, field).tobytes() == getattr(other, field).tobytes()
    assert list(robot.sweeps())[3].ranges.tobytes() == first[3].ranges.tobytes()


def test_another_seed_gives_other_noise_on_the_same_route() -> None:
    other = list(SimulatedRobot(SCENE, "r2", 8, duration_s=30.0).sweeps())
    assert not np.array_equal(record()[0].ranges, other[0].ranges)
    np.testing.assert_array_equal(SimulatedRobot(SCENE, "r2", 8).pose(9.0), SimulatedRobot(SCENE, "r2", 7).pose(9.0))


@pytest.mark.parametrize("lidar", ["lds01", "rplidar_a1", "sick", "urg04lx", "utm30lx"])
def test_sweeps_come_at_the_lasers_rate_and_end_within_the_duration(lidar: str) -> None:
    robot = SimulatedRobot(SCENE, "r2", 7, lidar=lidar, duration_s=20.0)
    sweeps = list(robot.sweeps())
    np.testing.assert_allclose(np.diff([sweep.stamp for sweep in sweeps]), robot.lidar.period)
    assert 20.0 - 2 * robot.lidar.period < sweeps[-1].stamp + robot.lidar.offsets()[-1] <= 20.0
    assert all(len(sweep.ranges) == robot.lidar.beams for sweep in sweeps)


def test_every_sample_comes_once_and_none_later_than_its_sweep() -> None:
    sweeps = record()
    for field, rate in (("odometry", 20), ("imu", 50)):
        parts = [getattr(sweep, field) for sweep in sweeps]
        np.testing.assert_allclose(np.diff(np.vstack(parts)[:, 0]), 1 / rate)
        for sweep, part in zip(sweeps, parts, strict=True):
            end = sweep.stamp + (len(sweep.ranges) - 1) * sweep.geometry.time_increment
            assert end - 1 / rate < part[-1, 0] <= end
    assert sweeps[0].odometry is not None
    np.testing.assert_array_equal(sweeps[0].odometry[0], np.zeros(4))


def test_a_robot_can_do_without_wheels_and_imu() -> None:
    bare = record(wheels=False, imu=False)
    assert all(sweep.odometry is None and sweep.imu is None for sweep in bare)
    np.testing.assert_array_equal(bare[5].ranges, record()[5].ranges)


def test_ranges_laid_out_from_the_true_poses_lie_on_walls() -> None:
    robot = SimulatedRobot(SCENE, "r2", 7, duration_s=30.0, mount=(0.1, 0.02, 0.2))
    off = []
    for sweep in list(robot.sweeps())[::10]:
        beams = np.flatnonzero(np.isfinite(sweep.ranges))
        laser = compose(robot.poses(sweep.stamp + beams * sweep.geometry.time_increment), sweep.geometry.mount)
        angles = sweep.geometry.angle_min + sweep.geometry.angle_increment * beams
        ends = sweep.ranges[beams, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        world = np.vstack([apply(pose, end[None]) for pose, end in zip(laser, ends, strict=True)])
        off.append(SCENE.world.clearance(world))
    assert np.median(np.concatenate(off)) < 0.02
    assert np.concatenate(off).max() < 0.3


def test_no_compiled_or_image_library_is_loaded_before_the_first_ray() -> None:
    code = (
        "import sys; from common.sim import load_scene, SimulatedRobot;"
        "SimulatedRobot(load_scene('apartment'), 'r1', 0).pose(3.0);"
        "print([name for name in ('numba', 'cv2', 'scipy') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
