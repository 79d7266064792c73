"""Graph SLAM as a whole: accuracy with the sensors that robots have, determinism, and what must not break it."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import changed, driven, error, robot, run

from common.errors import ConfigError
from common.evaluation.maps import wall_thickness
from common.evaluation.trajectory import absolute_error
from common.wire import Frame
from services.edge_worker.slam.graph.graph_slam import GraphSlam
from services.edge_worker.slam.registry import create


@pytest.mark.parametrize(
    ("how", "limit_m"),
    [
        ({}, 0.015),
        ({"imu": False}, 0.02),
        ({"wheels": False}, 0.03),
        ({"wheels": False, "imu": False}, 0.05),
        ({"lidar": "lds01"}, 0.03),
        ({"noise": "slippery"}, 0.025),
        ({"mount": (0.2, -0.1, 1.0)}, 0.02),
    ],
    ids=["wheels and gyro", "wheels", "gyro", "laser alone", "short-sighted laser", "slip", "laser mounted askew"],
)
def test_the_trajectory_is_right_with_whatever_sensors_there_are(how: dict, limit_m: float) -> None:
    kernel = run(driven(**how))
    kernel.finish()
    assert error(kernel, robot(**how)).rmse < limit_m


def test_walls_are_thin_and_rooms_are_free() -> None:
    grid = run(driven()).map()
    occupancy, _ = grid.occupancy()
    assert wall_thickness(occupancy) < 2.0
    assert (occupancy == 0).sum() * grid.resolution**2 > 40.0


def test_the_same_frames_give_the_same_map_bit_for_bit_however_often_it_was_asked_for() -> None:
    frames = driven()
    quiet, curious = run(frames), GraphSlam.create({}, 7)
    for frame in frames:
        curious.process(frame)
        if frame.seq % 9 == 0:
            curious.map()
    for kernel in (quiet, curious):
        kernel.finish()
    assert quiet.map().digest() == curious.map().digest()
    assert np.array_equal(quiet.trajectory(), curious.trajectory())


def test_every_frame_has_a_row_and_the_map_is_one_object_with_rising_versions() -> None:
    frames = driven()[:60]
    kernel = run(frames[:30])
    grid, version = kernel.map(), kernel.map().version
    for frame in frames[30:]:
        kernel.process(frame)
    assert kernel.map() is grid
    assert grid.version > version
    assert kernel.map().version == grid.version
    assert kernel.trajectory()[:, 0].tolist() == [frame.stamp for frame in frames]


def test_a_loop_brings_the_drift_back_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    # a laser that sees a few metres drifts from room to room; one that sees through all of them has no drift to lose
    drive = {"duration_s": 110.0, "noise": "worn", "imu": False, "lidar": "lds01"}
    with_loops = run(driven(**drive), local_keyframes=15)
    monkeypatch.setattr(GraphSlam, "_close_loops", lambda _: None)
    without = run(driven(**drive), local_keyframes=15)
    with_loops.finish()
    assert with_loops.graph.loops.any()
    assert not without.graph.loops.any()
    assert error(with_loops, robot(**drive)).rmse < error(without, robot(**drive)).rmse


def test_standing_still_makes_one_keyframe() -> None:
    frames = [changed(driven()[0], seq=k, stamp=k * 0.2, odometry=None, imu=None) for k in range(40)]
    kernel = run(frames)
    assert len(kernel.keyframes) == 1
    assert np.abs(kernel.pose).max() < 0.01


def test_scans_without_a_usable_beam_move_the_pose_by_odometry() -> None:
    frames = driven()
    kernel, truth = run(frames[:20]), robot()
    blind = [
        changed(f, np.full(len(f.scan.ranges), v)) for f, v in zip(frames[20:26], [np.nan, np.inf] * 3, strict=True)
    ]
    blind[2] = changed(frames[22], scan=None)
    for frame in blind:
        estimate = kernel.process(frame)
        assert not estimate.matched
    for frame in frames[26:60]:
        estimate = kernel.process(frame)
    assert estimate.matched
    assert error(kernel, truth).max < 0.1


def test_any_beam_count_will_do_and_may_change_between_frames() -> None:
    kernel = GraphSlam.create({}, 0)
    for k, frame in enumerate(driven()):
        step = (1, 2, 3)[k % 3]
        scan = frame.scan.model_copy(
            update={
                "ranges": frame.scan.ranges[::step].copy(),
                "angle_increment": frame.scan.angle_increment * step,
                "time_increment": frame.scan.time_increment * step,
            }
        )
        kernel.process(changed(frame, scan=scan))
    assert error(kernel, robot()).rmse < 0.03


def test_garbage_among_the_ranges_is_dropped() -> None:
    rng, kernel = np.random.default_rng(5), GraphSlam.create({}, 0)
    for frame in driven():
        ranges = frame.scan.metres().astype(np.float64)
        ranges[rng.random(len(ranges)) < 0.2] = np.nan
        ranges[rng.random(len(ranges)) < 0.1] = np.inf
        ranges[rng.random(len(ranges)) < 0.05] = 0.01
        kernel.process(changed(frame, ranges))
    assert error(kernel, robot()).rmse < 0.03


def test_a_clock_that_steps_back_or_pauses_costs_no_frame() -> None:
    frames = driven()
    stepped = [
        *frames[:40],
        *(shifted(frame, -5.0) for frame in frames[40:80]),
        *(shifted(f, 60.0) for f in frames[80:]),
    ]
    kernel = run(stepped)
    rows = kernel.trajectory()
    assert len(rows) == len(frames)
    truth = robot().poses([frame.stamp for frame in frames])
    back = np.column_stack([[frame.stamp for frame in frames], rows[:, 1:]])
    assert absolute_error([back], [np.column_stack([back[:, 0], truth])]).max < 0.1


def shifted(frame: Frame, by: float) -> Frame:
    """The frame as a clock that is off by `by` s would stamp it."""
    step = np.array([by, 0.0, 0.0, 0.0])
    return changed(frame, stamp=frame.stamp + by, odometry=frame.odometry + step, imu=frame.imu + step)


def test_nonsense_from_wheels_and_gyro_is_not_believed() -> None:
    rng, kernel = np.random.default_rng(4), GraphSlam.create({}, 0)
    for frame in driven():
        odometry, imu = frame.odometry.copy(), frame.imu.copy()
        if rng.random() < 0.1:
            odometry[rng.integers(len(odometry)), 1:] = rng.choice([1e300, -1e9, np.nan, 50.0])
            imu[rng.integers(len(imu)), 1] = rng.choice([1e300, -1e6, np.nan, 200.0])
        kernel.process(changed(frame, odometry=odometry, imu=imu))
    assert error(kernel, robot()).rmse < 0.05


def test_wheels_that_err_in_distance_are_found_out() -> None:
    frames = [
        changed(f, odometry=f.odometry * [1.0, 1.08, 1.08, 1.0] if f.odometry is not None else None)
        for f in driven(noise="none")
    ]
    assert run(frames).reader.reckoning.wheels.scale == pytest.approx(1 / 1.08, abs=0.01)


def test_no_submap_spans_a_break_of_tracking() -> None:
    frames = list(driven(duration_s=60.0))
    for k in range(100, 150):
        frames[k] = changed(frames[k], scan=None)
    kernel = run(frames)
    torn = kernel.closer.torn
    assert 0 < torn < len(kernel.keyframes) - 1
    assert all(submap.members[-1] < torn or submap.members[0] >= torn for submap in kernel.closer.submaps)


def test_robots_that_pass_by_are_cleared_from_the_map() -> None:
    alone, among = run(driven()).map(), run(driven(peers=("r2", "r3", "r4"))).map()
    walls, seen = (set(map(tuple, np.argwhere(cells(grid)))) for grid in (alone, among))
    near = {(y + dy, x + dx) for y, x in walls for dy in (-1, 0, 1) for dx in (-1, 0, 1)}
    assert len(seen - near) < 0.03 * len(seen)


def cells(grid: object) -> np.ndarray:
    """Occupied cells on a lattice that does not depend on the grid's bounds."""
    occupancy, (x0, y0) = grid.occupancy()
    out = np.zeros((1024, 1024), bool)
    out[y0 + 512 : y0 + 512 + occupancy.shape[0], x0 + 512 : x0 + 512 + occupancy.shape[1]] = occupancy == 100
    return out


def test_beams_that_meet_nothing_clear_the_map_only_when_asked_to() -> None:
    far = [changed(frame, np.where(frame.scan.metres() > 2.0, np.inf, frame.scan.metres())) for frame in driven()[:30]]
    kept, cleared = run(far).map(), run(far, clear_m=5.0).map()
    free = [int((grid.occupancy()[0] == 0).sum()) for grid in (kept, cleared)]
    assert free[1] > 1.5 * free[0]


def test_the_number_of_keyframes_stays_bounded_and_the_trajectory_right() -> None:
    kernel = run(driven(duration_s=80.0), max_keyframes=60, local_keyframes=20)
    kernel.finish()
    assert len(kernel.keyframes) <= 60
    assert error(kernel, robot(duration_s=80.0)).rmse < 0.03
    curious = GraphSlam.create({"max_keyframes": 60, "local_keyframes": 20}, 0)
    for frame in driven(duration_s=80.0):
        curious.process(frame)
        curious.prepare(0.0)
        if frame.seq % 50 == 0:
            curious.map()
    curious.finish()
    assert curious.map().digest() == kernel.map().digest()


def test_bad_settings_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="resolution_m"):
        create("graph", {"resolution_m": -1})
    with pytest.raises(ConfigError, match="particles"):
        create("graph", {"particles": 30})
