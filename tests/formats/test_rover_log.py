"""The rover's logs: ranges in mm, encoder counts to odometry."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from common.errors import BadFile
from common.formats.rover import RoverLog, dead_reckon

DATA = os.environ.get("RECSLAM_DATA")
TURN = 2000
WHEEL = 2 * math.pi * 0.077


def row(micros: int, left: int, right: int, *ranges: int) -> str:
    return " ".join(map(str, [micros, 0, left, right, *[0] * 20, *ranges]))


def test_a_row_becomes_a_sweep(tmp_path):
    path = tmp_path / "a.dat"
    path.write_text(
        row(2_500_000, 7, 9, 0, 19, 1234, 5601) + "\n" + row(2_600_000, 7 + TURN, 9 + TURN, 1, 2, 3, 4) + "\n"
    )
    first, second = RoverLog(path)
    assert first.stamp == pytest.approx(2.5 - 0.15)
    np.testing.assert_array_equal(first.ranges, np.array([np.nan, np.nan, 1.234, np.inf], np.float32))
    np.testing.assert_allclose(first.odometry, [[2.5, 0, 0, 0]])
    np.testing.assert_allclose(second.odometry, [[2.6, WHEEL, 0, 0]])
    assert first.geometry.mount == (0.145, 0, 0)
    assert first.geometry.angle_min == pytest.approx(-1.5 * first.geometry.angle_increment)
    assert first.geometry.time_increment == pytest.approx(0.1 / 1024)


def test_wheels_turning_apart_turn_the_rover_on_the_spot():
    per_turn = 0.33 * math.pi / 2 / 2 / WHEEL * TURN
    track = dead_reckon(np.array([[0, 0], [-per_turn, per_turn], [-per_turn + TURN, per_turn + TURN]]))
    np.testing.assert_allclose(track, [[0, 0, 0], [0, 0, math.pi / 2], [0, WHEEL, math.pi / 2]], atol=1e-12)


def test_broken_rows_are_counted_and_named(tmp_path):
    path = tmp_path / "a.dat"
    path.write_text("\n".join([row(2, 0, 0, 50, 60), "1 2 3", "x " + row(3, 0, 0, 5, 5), row(1, 0, 0, 50, 60)]))
    read = RoverLog(path)
    assert (len(read), read.malformed, read.disordered) == (1, 2, 1)
    assert "a.dat:2:" in read.summary()
    path.write_text("1 2 3")
    with pytest.raises(BadFile, match="no usable row"):
        RoverLog(path)


def test_a_row_of_a_wrong_clock_costs_no_other_row(tmp_path):
    path = tmp_path / "a.dat"
    path.write_text("\n".join(row(micros, 0, 0, 50, 60) for micros in (9000, 1, 2, 10**15, 3, 3, 4, 0, 5)))
    read = RoverLog(path)
    assert [sweep.stamp + 0.15 for sweep in read] == pytest.approx([1e-6, 2e-6, 3e-6, 4e-6, 5e-6])
    assert read.disordered == 4


@pytest.mark.skipif(not DATA, reason="RECSLAM_DATA does not name a folder of real logs")
@pytest.mark.parametrize(("name", "sweeps"), [("exp1", 756), ("exp2", 641)])
def test_real_runs_are_read_whole(name, sweeps):
    read = RoverLog(Path(DATA) / "multi_session" / f"{name}.dat.gz")
    assert (len(read), read.malformed, read.disordered) == (sweeps, 0, 0)
    track = np.concatenate([sweep.odometry for sweep in read])
    assert 20 < np.hypot(*np.diff(track[:, 1:3], axis=0).T).sum() < 100
    assert {len(sweep.ranges) for sweep in read} == {683}
