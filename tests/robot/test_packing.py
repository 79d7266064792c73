"""What travels: ranges within half a quantum, their special values exactly, and no unsound scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.errors import BadSweep
from common.sweep import LaserGeometry, Sweep
from common.wire import Frame, decode, encode
from common.wire.limits import MAX_BEAMS, MAX_SAMPLES
from services.robot_agent.packing import pack, unpack

STREAM = "0" * 32
GEOMETRY = LaserGeometry(angle_min=-1.5, angle_increment=0.01, range_min=0.1, range_max=8.0)


def sweep(ranges: object = (1.0, 2.0), **changes: object) -> Sweep:
    return replace(Sweep(12.5, GEOMETRY, np.asarray(ranges, np.float32)), **changes)  # type: ignore[arg-type]


def frame_of(taken: Sweep, **options: object) -> Frame:
    frame = decode(encode(pack(taken, "r1", STREAM, 7, **options)))  # type: ignore[arg-type]
    assert isinstance(frame, Frame)
    return frame


@given(
    hnp.arrays(np.float32, st.integers(1, 50), elements=st.floats(0, 300, width=32)),
    st.sampled_from([8.0, 60.0, 100.0, 300.0, 1000.0]),
)
def test_ranges_arrive_within_half_a_quantum(ranges: np.ndarray, range_max: float) -> None:
    ranges = np.minimum(ranges, np.float32(range_max))
    frame = frame_of(sweep(ranges, geometry=replace(GEOMETRY, range_max=range_max)))
    assert frame.scan is not None
    assert np.abs(frame.scan.metres() - ranges).max() <= frame.scan.quantum / 2 + 1e-5


def test_special_ranges_mean_what_they_meant() -> None:
    frame = frame_of(sweep([np.nan, np.inf, -np.inf, 0.0, 8.0]))
    assert frame.scan is not None
    assert frame.scan.ranges.dtype == np.uint16
    np.testing.assert_array_equal(frame.scan.metres()[:3], [np.nan, np.inf, -np.inf])


def test_lossless_ranges_arrive_bit_for_bit() -> None:
    ranges = np.random.default_rng(1).uniform(0, 8, 100).astype(np.float32)
    frame = frame_of(sweep(ranges), lossless=True)
    assert frame.scan is not None
    assert frame.scan.quantum == 0
    np.testing.assert_array_equal(frame.scan.metres(), ranges)


def test_a_laser_beyond_what_uint16_can_say_is_sent_lossless() -> None:
    frame = frame_of(sweep([400.0], geometry=replace(GEOMETRY, range_max=500.0)))
    assert frame.scan is not None
    assert frame.scan.metres().tolist() == [400.0]


def test_a_frame_packed_again_is_the_same_frame() -> None:
    ranges = np.r_[np.random.default_rng(2).uniform(0, 80, 1000), np.nan, np.inf]
    odometry = np.random.default_rng(3).normal(size=(5, 4))
    for far in (8.0, 81.9, 200.0, 400.0):
        frame = pack(sweep(ranges, geometry=replace(GEOMETRY, range_max=far), odometry=odometry), "r1", STREAM, 7)
        again = unpack(frame)
        assert again is not None
        assert encode(pack(again, "r1", STREAM, 7)) == encode(frame)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (sweep([]), "no beams"),
        (sweep(np.ones(MAX_BEAMS + 1)), "more than the limit"),
        (sweep(np.ones((3, 3))), "shape"),
        (sweep(stamp=np.nan), "stamp"),
        (sweep(geometry=replace(GEOMETRY, angle_min=np.nan)), "angle_min"),
        (sweep(geometry=replace(GEOMETRY, angle_increment=0.0)), "angle_increment"),
        (sweep(geometry=replace(GEOMETRY, range_max=0.05)), "range_max"),
        (sweep(geometry=replace(GEOMETRY, range_max=np.inf)), "range_max"),
        (sweep(geometry=replace(GEOMETRY, mount=(0.0, np.nan, 0.0))), "mount"),
        (sweep(odometry=np.full((1, 4), np.nan)), "odometry"),
        (sweep(odometry=np.zeros((1, 3))), "odometry"),
        (sweep(imu=np.zeros((MAX_SAMPLES + 1, 4))), "imu"),
    ],
)
def test_an_unsound_scan_is_refused_by_name(bad: Sweep, reason: str) -> None:
    with pytest.raises(BadSweep, match=reason):
        pack(bad, "r1", STREAM, 0)


@given(hnp.arrays(np.float32, st.integers(1, 40), elements=st.floats(width=32)))
def test_no_ranges_at_all_can_stop_a_robot(ranges: np.ndarray) -> None:
    assert frame_of(sweep(ranges)).scan is not None
    assert frame_of(sweep(ranges), lossless=True).scan is not None
