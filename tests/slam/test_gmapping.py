"""Promises of the `gmapping` kernel as a whole."""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from gmapping_cases import BEAMS, FEW, WALLS, changed, drive, errors, ranges_at, route, run

from common.errors import ConfigError
from common.geometry import between
from common.wire import Frame, LaserScan
from services.edge_worker.slam.gmapping.gmapping import GMapping


@pytest.mark.parametrize(("odometry", "imu"), [(True, False), (False, True), (False, False)])
def test_a_room_is_mapped_with_and_without_odometry(odometry: bool, imu: bool) -> None:
    kernel = run(drive(120, odometry, imu))
    metres, radians = errors(kernel, 120)
    assert metres < 0.06
    assert radians < 0.03
    cells, (x0, y0) = kernel.map().occupancy()
    walls = np.argwhere(cells == 100)[:, ::-1] * 0.05 + 0.025 + np.array([x0, y0]) * 0.05
    along = WALLS[:, 1] - WALLS[:, 0]
    share = np.clip(((walls[:, None] - WALLS[:, 0]) * along).sum(-1) / np.square(along).sum(-1), 0, 1)
    off = np.linalg.norm(walls[:, None] - WALLS[:, 0] - share[..., None] * along, axis=-1).min(axis=1)
    assert len(walls) > 300
    assert (off < 0.1).mean() > 0.95
    assert (cells[-y0, -x0], cells[-y0 + 10, -x0]) == (0, 0)


def test_equal_seeds_give_equal_maps_and_other_seeds_others() -> None:
    frames = drive(60)
    first, again, other = run(frames), run(frames), run(frames, seed=2)
    assert first.map().digest() == again.map().digest()
    assert np.array_equal(first.trajectory(), again.trajectory())
    assert not np.array_equal(first.trajectory(), other.trajectory())


def test_a_robot_that_starts_suddenly_in_a_corridor_is_not_taken_for_one_whose_wheels_slip() -> None:
    """Walls alike all along tell nothing of the way: odometry, here true, does."""
    angles = -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1.0 / np.abs(np.sin(angles)), 20.0).astype(np.float32)
    way = np.cumsum([0.06] * 20 + [0.3] * 10)
    frames = [
        changed(frame, ranges=ranges).model_copy(update={"odometry": np.array([[frame.stamp, x, 0.0, 0.0]])})
        for frame, x in zip(drive(len(way)), way, strict=True)
    ]
    rows = run(frames).trajectory()
    assert rows[-1, 1] - rows[0, 1] == pytest.approx(way[-1] - way[0], rel=0.1)


def test_scans_without_a_usable_beam_move_the_pose_by_odometry() -> None:
    frames = drive(40)
    nothing = [np.full(BEAMS, value, np.float32) for value in (np.nan, np.inf, -np.inf, 0.0, 99.0)]
    kernel = run(frames[:20])
    before = kernel.trajectory()[-1, 1:]
    for frame, ranges in zip(frames[20:25], nothing, strict=True):
        assert not kernel.process(changed(frame, ranges=ranges)).matched
    assert not kernel.process(frames[25].model_copy(update={"scan": None})).matched
    assert not kernel.process(changed(frames[26], ranges=np.empty(0, np.float32))).matched
    a, b = frames[19].odometry, frames[26].odometry
    assert a is not None
    assert b is not None
    np.testing.assert_allclose(between(before, kernel.trajectory()[-1, 1:]), between(a[0, 1:], b[0, 1:]), atol=1e-9)
    for frame in frames[27:]:
        kernel.process(frame)
    assert errors(kernel, 40)[0] < 0.06


def test_a_stream_that_begins_blind_is_mapped_from_the_first_scan_on() -> None:
    frames = drive(40)
    blind = [changed(frame, ranges=np.full(BEAMS, np.inf, np.float32)) for frame in frames[:10]]
    kernel = run(blind + frames[10:])
    assert errors(kernel, 40)[0] < 0.08
    assert run(blind).map().tiles == {}
    assert len(GMapping.create({}, 0).trajectory()) == 0


def test_the_number_of_beams_may_change_and_stamps_may_step_back() -> None:
    frames = drive(60)
    mixed = []
    for k, frame in enumerate(frames):
        beams = (90, 180, 361)[k % 3]
        ranges = ranges_at(route(60)[k], beams).astype(np.float32)
        ranges[::7] = np.nan
        mixed.append(changed(frame, ranges=ranges, angle_increment=2 * np.pi / beams))
    mixed[30:] = [
        frame.model_copy(update={"stamp": frame.stamp - 3.0, "odometry": frame.odometry - [3.0, 0, 0, 0]})
        for frame in mixed[30:]
        if frame.odometry is not None
    ]
    kernel = run(mixed)
    assert errors(kernel, 60)[0] < 0.06
    assert np.array_equal(kernel.trajectory()[:, 0], [frame.stamp for frame in mixed])


def test_patches_stay_bounded_in_a_known_place_and_the_tree_settles() -> None:
    frames = drive(240)
    kernel = GMapping.create({**FEW, "lag_scans": 20}, 3)
    held = []
    for frame in frames:
        kernel.process(frame)
        held.append(kernel.maps.held)
        assert len(kernel.tree.branches) <= 21
    assert max(held[120:]) < 1.3 * max(held[:120])
    assert len(kernel.tree.settled) > 20
    assert errors(kernel, 240)[0] < 0.06


def test_settings_are_refused_by_the_name_of_the_field() -> None:
    for settings, field in (({"particles": 0}, "particles"), ({"ogain": 3}, "ogain"), ({"reach_m": 0.5}, "reach_m")):
        with pytest.raises(ConfigError, match=field):
            GMapping.create(settings, 0)


DATA = os.environ.get("RECSLAM_DATA", "")


def intel(count: int) -> Iterator[Frame]:
    """The first frames of the Intel log, odometry as logged with each scan."""
    with gzip.open(Path(DATA) / "logs/intel.raw.log.gz", "rt") as lines:
        scans = [line.split() for line in lines if line.startswith("FLASER")][:count]
    for k, fields in enumerate(scans):
        n = int(fields[1])
        x, y, theta, stamp = (float(value) for value in fields[n + 5 : n + 9])
        scan = LaserScan(
            angle_min=-np.pi / 2,
            angle_increment=np.pi / 180,
            range_min=0.05,
            range_max=81.8,
            quantum=0,
            ranges=np.array(fields[2 : n + 2], np.float32),
        )
        odometry = np.array([[stamp, x, y, theta]])
        yield Frame(robot="intel", stream="0" * 32, seq=k, stamp=stamp, scan=scan, odometry=odometry)


@pytest.mark.skipif(not DATA, reason="RECSLAM_DATA names no folder of real logs")
def test_the_first_loop_of_the_intel_log_agrees_with_the_reference() -> None:
    rows = run(list(intel(250)), particles=15).trajectory()
    reference = np.loadtxt(Path(DATA) / "reference/intel.ref.txt.gz")
    at = np.abs(rows[:, :1] - reference[:, 0]).argmin(axis=1)
    same = np.flatnonzero(np.abs(rows[:, 0] - reference[at, 0]) < 1e-3)
    assert len(same) > 200
    ours, theirs = rows[same, 1:], reference[at[same], 1:4]
    off = between(between(ours[:-20], ours[20:]), between(theirs[:-20], theirs[20:]))
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.1
