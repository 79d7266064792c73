"""CARMEN logs: what a line says is what a sweep holds, whatever is wrong with its neighbours."""

from __future__ import annotations

import gzip
import math
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import BadFile
from common.formats.carmen import CarmenLog

DATA = os.environ.get("RECSLAM_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="RECSLAM_DATA does not name a folder of real logs")


def flaser(stamp: float, ranges: list[float], robot=(1.0, 2.0, 0.5), laser=None, kind: str = "FLASER") -> str:
    laser = laser or robot
    numbers = " ".join(map(str, [len(ranges), *ranges, *laser, *robot]))
    return f"{kind} {numbers} {stamp:.6f} host {stamp - 5:.6f}"


def odom(stamp: float, x: float = 0.0) -> str:
    return f"ODOM {x} 0 0 0.1 0 0 {stamp:.6f} host 0.1"


def log(folder: Path, *lines: str, **options) -> CarmenLog:
    path = folder / "a.log"
    path.write_text("\n".join(lines) + "\n")
    return CarmenLog(path, **options)


@pytest.mark.parametrize(("beams", "step"), [(180, 1.0), (360, 0.5), (181, 1.0), (361, 0.5)])
def test_beams_start_at_the_right_and_step_by_what_their_number_says(tmp_path, beams, step):
    (sweep,) = log(tmp_path, flaser(10.0, [1.0] * beams))
    assert math.degrees(sweep.geometry.angle_min) == pytest.approx(-90)
    assert math.degrees(sweep.geometry.angle_increment) == pytest.approx(step)
    assert len(sweep.ranges) == beams


def test_the_ipc_stamp_is_kept_to_the_microsecond(tmp_path):
    (sweep,) = log(tmp_path, flaser(976052890.244111, [1.0, 2.0]))
    assert sweep.stamp == 976052890.244111
    assert sweep.odometry[-1].tolist() == [976052890.244111, 1.0, 2.0, 0.5]


def test_odometry_goes_with_the_first_sweep_at_or_after_it(tmp_path):
    lines = [odom(1.0), odom(2.0), flaser(2.5, [1, 1]), odom(3.0), flaser(4.0, [1, 1]), odom(5.0)]
    first, second = log(tmp_path, *lines)
    assert first.odometry[:, 0].tolist() == [1.0, 2.0, 2.5]
    assert second.odometry[:, 0].tolist() == [3.0, 4.0]


def test_no_return_is_infinite_and_zero_is_invalid(tmp_path):
    (sweep,) = log(tmp_path, flaser(1.0, [0.0, 81.9, 3.5, 50.0]))
    np.testing.assert_array_equal(sweep.ranges, np.array([np.nan, np.inf, 3.5, np.inf], np.float32))
    (sweep,) = log(tmp_path, "PARAM robot_front_laser_max 8.1", flaser(1.0, [8.0, 8.1]))
    np.testing.assert_array_equal(sweep.ranges, np.array([8.0, np.inf], np.float32))
    assert sweep.geometry.range_max == 8.1
    (sweep,) = log(tmp_path, flaser(1.0, [8.0, 30.0]), range_max=20.0)
    assert sweep.ranges[1] == np.inf


def test_a_reading_too_large_for_any_number_is_no_return_and_no_warning(tmp_path):
    with warnings.catch_warnings(action="error"):
        (sweep,) = log(tmp_path, flaser(1.0, ["1e39", "1e400", 2.0]))
    np.testing.assert_array_equal(sweep.ranges, np.array([np.inf, np.inf, 2], np.float32))


def test_a_laser_off_the_robots_centre_is_mounted_there(tmp_path):
    robot, ahead = (1.0, 2.0, math.pi / 2), (1.0, 2.2, math.pi / 2)
    (sweep,) = log(tmp_path, flaser(1.0, [1, 1], robot, ahead))
    assert sweep.geometry.mount == pytest.approx((0.2, 0.0, 0.0))


def test_a_rear_laser_looks_back(tmp_path):
    (sweep,) = log(tmp_path, flaser(1.0, [1.0] * 180, kind="RLASER"))
    assert sweep.geometry.angle_min == pytest.approx(math.pi / 2)


def test_a_described_laser_is_read_as_it_says(tmp_path):
    config = "0 -2.0 4.0 0.1 30.0 0.01 0 3 1.0 31.0 2.0"
    row = f"ROBOTLASER1 {config} 2 7 7 0.3 0 0 0 0 0 0.1 0.2 0.3 0.4 0.5 77.5 host 0.1"
    (sweep,) = log(tmp_path, "RAWLASER1 x", row)
    assert (sweep.stamp, sweep.geometry.angle_min, sweep.geometry.angle_increment) == (77.5, -2.0, 0.1)
    assert sweep.geometry.mount == (0.3, 0.0, 0.0)
    np.testing.assert_array_equal(sweep.ranges, np.array([1, np.inf, 2], np.float32))
    (raw,) = log(tmp_path, odom(77.0), f"RAWLASER1 {config} 0 77.5 host 0.1")
    assert raw.stamp == 77.5
    assert raw.odometry[:, 0].tolist() == [77.0]


def test_a_malformed_row_is_counted_and_named_and_the_rest_is_read(tmp_path):
    broken = [flaser(2.0, [1, 1])[:20], "FLASER 9999 1 2", "ODOM nan 0 0 0 0 0 2.0 h 0", "FLASER", "\xff\x00"]
    read = log(tmp_path, flaser(1.0, [1, 1]), *broken, flaser(3.0, [1, 1]))
    assert [sweep.stamp for sweep in read] == [1.0, 3.0]
    assert read.malformed == 4
    assert f"{read.path}:2:" in read.first_malformed
    assert "4 malformed" in read.summary()


def test_a_truncated_gzip_is_refused_by_name(tmp_path):
    path = tmp_path / "cut.log.gz"
    path.write_bytes(gzip.compress("\n".join(flaser(i, [i, 2.0]) for i in range(1, 999)).encode())[:-200])
    with pytest.raises(BadFile, match=r"cut\.log\.gz.*after line \d+"):
        CarmenLog(path)


def test_a_file_without_lasers_is_refused(tmp_path):
    with pytest.raises(BadFile, match="no laser rows"):
        log(tmp_path, odom(1.0))
    with pytest.raises(BadFile, match="no usable RLASER"):
        log(tmp_path, flaser(1.0, [1, 1]), laser="RLASER")
    with pytest.raises(BadFile, match=r"no usable FLASER row .*1 with stamps out of order"):
        log(tmp_path, odom(1.0), odom(2.0), flaser(9e9, [1, 1]), odom(3.0), odom(4.0))
    with pytest.raises(BadFile, match="is no laser"):
        log(tmp_path, flaser(1.0, [1, 1]), laser="SONAR")
    with pytest.raises(BadFile, match="gone"):
        CarmenLog(tmp_path / "gone")


def test_scans_stamped_late_are_sorted_and_contradicting_odometry_is_left_out(tmp_path):
    # The second scan was stamped 0.8 s late; the ODOM row at 2.2 was taken after it.
    read = log(tmp_path, flaser(1.0, [1, 1]), flaser(2.8, [2, 2]), odom(2.2), flaser(2.5, [3, 3]), odom(3), odom(3.5))
    assert [(sweep.stamp, sweep.ranges[0]) for sweep in read] == [(1.0, 1.0), (2.5, 3.0), (2.8, 2.0)]
    assert read.disordered == 1
    assert all(len(sweep.odometry) == 1 for sweep in read)


def test_rows_of_a_clock_that_was_set_back_or_jumped_once_are_left_out(tmp_path):
    read = log(tmp_path, *(flaser(t, [1, 1]) for t in (100, 101, 9e9, 102, 10, 11, 103)))
    assert [sweep.stamp for sweep in read] == [100, 101, 102, 103]
    assert read.disordered == 3


@pytest.mark.parametrize("wrong", [range(10, 11), range(10, 13), range(0, 3), range(0, 40)])
@pytest.mark.parametrize("by_s", [-3600, 3600])
def test_a_clock_that_was_wrong_for_a_while_costs_only_the_rows_of_that_while(tmp_path, wrong, by_s):
    rows = [row(100 + i + by_s * (i in wrong), [1, 1]) for i in range(100) for row in (flaser, lambda t, _: odom(t))]
    stamps = [sweep.stamp for sweep in log(tmp_path, *rows)]
    right = [100 + i for i in range(100) if i not in wrong]
    assert [stamp for stamp in stamps if 0 <= stamp < 200] == right
    assert len(stamps) == (100 if by_s < 0 and wrong.start == 0 else len(right))  # late from the start on: it rises


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 40)), min_size=1, max_size=60))
def test_whatever_the_order_stamps_rise_and_no_scan_near_its_time_is_lost(tmp_path_factory, rows):
    lines = [flaser(t / 10, [1.0, 2.0]) if scan else odom(t / 10) for scan, t in rows] + [flaser(99.0, [1, 1])]
    read = log(tmp_path_factory.mktemp("log"), *lines)
    sweeps = list(read)
    assert [s.stamp for s in sweeps] == sorted({t / 10 for scan, t in rows if scan} | {99.0})
    samples = np.concatenate([s.odometry for s in sweeps])
    assert (np.diff(samples[:, 0]) > 0).all()
    assert all(s.odometry[-1, 0] == s.stamp for s in sweeps)


@needs_data
@pytest.mark.parametrize(
    ("name", "sweeps", "beams"),
    [("intel_dense.raw.log.gz", 2468, 180), ("aces.raw.log.gz", 440, 180), ("mit-csail.clf.gz", 1988, 361)],
)
def test_real_logs_are_read_whole(name, sweeps, beams):
    read = CarmenLog(Path(DATA) / "logs" / name)
    assert len(read) == sweeps
    assert read.malformed == 0
    assert {len(sweep.ranges) for sweep in read} == {beams}
    stamps = np.array([sweep.stamp for sweep in read])
    assert (np.diff(stamps) > 0).all()
    ranges = np.concatenate([sweep.ranges for sweep in read])
    assert np.isinf(ranges).any()
    assert np.nanmax(ranges[np.isfinite(ranges)]) < 50


def test_reading_logs_needs_nothing_that_a_robot_lacks():
    modules = "common.formats.carmen, common.formats.rover, common.formats.tum, common.formats.segments"
    code = (
        f"import sys, {modules}; print([m for m in ('cv2', 'scipy', 'numba', 'yaml', 'networkx') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
