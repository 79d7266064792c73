"""Frames that no robot sends: whatever they hold, a kernel goes on, and others in its process with it."""

from __future__ import annotations

import numpy as np
import pytest
from gmapping_cases import FEW, drive, errors, run

from common.errors import MapTooLarge
from common.wire import Frame, LaserScan
from common.wire.limits import MAX_ANGLE_RAD, MAX_MOUNT_M, MAX_STAMP_S
from services.edge_worker.slam.gmapping.gmapping import GMapping
from services.edge_worker.slam.registry import create

ODD = (0.0, 1e-300, -1e-9, 3.0, 17.0, -50.0, 1e3, 3e3, 1e6, -1e9, 1e15, 1e30, -1e300, np.nan, np.inf, -np.inf)
FIRST_WILD, WILD = 15, 30


def wild(frame: Frame, rng: np.random.Generator) -> Frame:
    """The frame with a few of its numbers odd, but such that the wire lets it pass."""

    def odd(value: float, most: float, least: float = -np.inf) -> float:
        chosen = float(rng.choice(ODD)) if rng.random() < 0.2 else value
        return float(np.clip(chosen, max(-most, least), most)) if np.isfinite(chosen) else value

    ranges = np.array(frame.scan.metres() if frame.scan else [], np.float32)
    ranges[rng.random(len(ranges)) < 0.1] = rng.choice([*ODD[:11], *ODD[-3:]])
    samples = np.full((int(rng.integers(0, 4)), 4), [frame.stamp, 0.1, 0.0, 0.0])
    samples = np.where(rng.random(samples.shape) < 0.2, rng.choice(ODD, samples.shape), samples)
    scan = LaserScan(
        angle_min=odd(-np.pi, MAX_ANGLE_RAD),
        angle_increment=odd(0.03, MAX_ANGLE_RAD),
        range_min=odd(0.1, 1e5, 0.0),
        range_max=odd(12.0, 1e5, 1e-300),
        time_increment=odd(0.001, 10.0, 0.0),
        mount=(odd(0.0, MAX_MOUNT_M), odd(0.0, MAX_MOUNT_M), odd(0.0, MAX_ANGLE_RAD)),
        quantum=0.0,
        ranges=ranges[: rng.integers(0, len(ranges) + 1)],
    )
    stamp = odd(frame.stamp, MAX_STAMP_S)
    return frame.model_copy(update={"scan": scan, "odometry": samples, "imu": samples[::-1].copy(), "stamp": stamp})


@pytest.mark.parametrize("name", ["graph", "gmapping"])
@pytest.mark.parametrize("seed", range(6))
def test_wild_frames_leave_finite_poses_and_a_map_of_bounded_size(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kernel = create(name, FEW if name == "gmapping" else {}, 0)
    for k, frame in enumerate(drive(60)):
        if FIRST_WILD <= k < FIRST_WILD + WILD and rng.random() < 0.5:
            frame = wild(frame, rng)
        assert np.isfinite(kernel.process(frame).pose).all()
    kernel.finish()
    assert np.isfinite(kernel.trajectory()[:, 1:]).all()
    assert len(kernel.map().tiles) < 10_000
    assert len(kernel.snapshot()) < 10_000_000


def test_a_sample_of_another_clock_does_not_end_odometry() -> None:
    frames = drive(60)
    late = np.array([[1e9, 0.0, 0.0, 0.0]])
    assert frames[10].odometry is not None
    odd = frames[10].model_copy(update={"odometry": np.concatenate([frames[10].odometry, late])})
    assert errors(run([*frames[:10], odd, *frames[11:]]), 60)[0] < 0.06


def test_a_robot_that_seems_to_be_kilometres_off_is_refused_by_name_and_can_come_back() -> None:
    frames = drive(40)
    kernel = run(frames[:20])
    kernel.since = np.array([5000.0, 0.0, 0.0])
    with pytest.raises(MapTooLarge, match="kernel 'graph'"):
        kernel.process(frames[20])
    kernel.since = np.zeros(3)
    assert kernel.process(frames[21]).matched


def test_odometry_that_catches_up_by_kilometres_is_not_believed() -> None:
    frames = drive(30)
    kernel = GMapping.create(FEW, 0)
    for k, frame in enumerate(frames):
        if k == 20:
            assert frame.odometry is not None
            frame = frame.model_copy(update={"odometry": frame.odometry + np.array([0, 3000.0, 0, 0])})
        kernel.process(frame)
    assert max(kernel.maps.table.shape) * 0.4 < 200
