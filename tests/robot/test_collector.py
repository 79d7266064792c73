"""From a source into the spool: what is bad is refused and counted, what ended goes on where it was."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from list_source import GEOMETRY, ListSource, sweeps

from common.config import CarmenSource, Fleet, RecordingSource, RobotEntry, SimSource
from common.errors import BadFile, SpoolFull
from common.wire import Frame
from services.robot_agent.collector import Collector
from services.robot_agent.sources.factory import make, peers_of
from services.robot_agent.spool import Spool

MB = 2**20


def take_all(collector: Collector, limit: int = 16) -> list[Frame]:
    frames: list[Frame] = []
    while not (taken := collector.take(limit)).ended:
        frames += taken.frames
    return frames


def test_bad_scans_are_refused_and_counted_and_the_robot_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given = sweeps(6)
    given[0] = replace(given[0], ranges=np.zeros(0, np.float32))
    given[3] = replace(given[3], geometry=replace(GEOMETRY, angle_increment=np.nan))
    with Spool(tmp_path / "s", "r1", MB) as spool:
        collector = Collector(ListSource(given), spool)
        frames = take_all(collector, limit=4)
        assert [frame.seq for frame in frames] == [0, 1, 2, 3]
        assert [frame.stamp for frame in frames] == [given[i].stamp for i in (1, 2, 4, 5)]
        assert collector.refused == 2
    assert "no beams" in str([vars(record) for record in caplog.records])


def test_frames_are_spooled_before_they_are_handed_on(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        taken = Collector(ListSource(sweeps(3)), spool).take(2)
        assert [frame.seq for frame in taken.frames] == [0, 1]
        assert spool.now().next_seq == 2
        assert taken.bytes == spool.now().bytes


def test_a_log_goes_on_where_the_last_run_left_it(tmp_path: Path) -> None:
    given = sweeps(9)
    given[2] = replace(given[2], ranges=np.zeros(0, np.float32))
    with Spool(tmp_path / "s", "r1", MB) as spool:
        first = list(Collector(ListSource(given), spool).take(4).frames)
    with Spool(tmp_path / "s", "r1", MB) as spool:
        rest = take_all(Collector(ListSource(given), spool))
    assert [frame.seq for frame in first + rest] == list(range(8))
    assert [frame.stamp for frame in first + rest] == [s.stamp for s in given if len(s.ranges)]


def test_a_live_source_does_not_skip_after_a_restart(tmp_path: Path) -> None:
    for start in (0, 3):
        with Spool(tmp_path / "s", "r1", MB) as spool:
            frames = take_all(Collector(ListSource(sweeps(3), can_wait=False), spool))
            assert [frame.seq for frame in frames] == [start, start + 1, start + 2]


def test_realtime_does_not_run_ahead_of_the_stamps_and_can_be_stopped(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        collector = Collector(ListSource(sweeps(2, step_s=3600.0)), spool, realtime=True)
        assert not collector.can_wait
        assert len(collector.take(1).frames) == 1
        started = time.monotonic()
        threading.Timer(0.05, collector.stop).start()
        assert not collector.take(1).frames
        assert time.monotonic() - started < 60
        assert spool.now().taken == 1  # the sweep that was waited for comes again after a restart


def test_a_full_disk_makes_a_log_wait_and_a_live_source_lose(tmp_path: Path) -> None:
    for can_wait, refused in ((True, 0), (False, 3)):
        with Spool(tmp_path / str(can_wait), "r1", MB) as spool:
            (pages,) = spool._db.execute("PRAGMA page_count").fetchone()
            spool._db.execute(f"PRAGMA max_page_count = {pages}")
            big = [replace(sweep, ranges=np.ones(9000, np.float32)) for sweep in sweeps(3)]
            collector = Collector(ListSource(big, can_wait), spool)
            if can_wait:
                threading.Timer(0.05, collector.stop).start()
            assert collector.take(3).frames == ()
            assert collector.refused == refused
            assert spool.now().next_seq == 0


def test_a_full_disk_is_told_once_until_it_takes_frames_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(spool: Spool, frames: list[bytes], taken: int) -> int:
        raise SpoolFull("disk is full")

    caplog.set_level("INFO")
    with Spool(tmp_path / "s", "r1", MB) as spool:
        collector = Collector(ListSource(sweeps(8), can_wait=False), spool)
        for _ in range(2):
            with monkeypatch.context() as full:
                full.setattr(Spool, "append", refuse)
                assert [collector.take(1).frames for _ in range(3)] == [()] * 3
            assert len(collector.take(1).frames) == 1
    assert [record.message for record in caplog.records] == ["spool takes no more", "spool takes frames again"] * 2


def entry(source: SimSource | CarmenSource | RecordingSource, robot: str = "r1") -> RobotEntry:
    return RobotEntry(id=robot, source=source)


def test_a_recording_replays_the_frames_it_holds(tmp_path: Path) -> None:
    with Spool(tmp_path / "old", "r1", MB, keep_durable=True) as spool:
        recorded = take_all(Collector(ListSource(sweeps(20)), spool))
        spool.trim(10)
        source = make(entry(RecordingSource(path=tmp_path / "old"), "r2"), Fleet())  # also while it is being written
    assert source.profile.sensor == "laser"
    with Spool(tmp_path / "new", "r2", MB) as spool:
        replayed = take_all(Collector(source, spool))
        changed = {"robot": "r1", "stream": recorded[0].stream}
        for old, new in zip(recorded, replayed, strict=True):
            assert old.scan is not None
            assert new.scan is not None
            np.testing.assert_array_equal(old.scan.ranges, new.scan.ranges)
            assert old.model_copy(update={"scan": None}) == new.model_copy(update={"scan": None, **changed})


def test_a_recording_without_its_beginning_is_refused(tmp_path: Path) -> None:
    with Spool(tmp_path / "old", "r1", MB) as spool:
        take_all(Collector(ListSource(sweeps(20)), spool))
        spool.trim(10)
    with pytest.raises(BadFile, match=r"robot\.record"):
        make(entry(RecordingSource(path=tmp_path / "old")), Fleet())


@pytest.mark.parametrize("content", [None, b"no spool at all" * 100])
def test_a_file_that_is_no_recording_is_refused_by_name(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "x.spool"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadFile, match=r"x\.spool"):
        make(entry(RecordingSource(path=path)), Fleet())


@pytest.mark.parametrize("seed", [0, -(10**12)])
def test_robots_of_one_log_share_it_without_gap_or_overlap(tmp_path: Path, seed: int) -> None:
    log = tmp_path / "tiny.log"
    row = "FLASER 4 1.0 2.0 3.0 4.0 {x} 0.0 0.0 {x} 0.0 0.0 {t} host {t}\n"
    log.write_text("".join(row.format(x=0.1 * i, t=1000.0 + i) for i in range(12)))
    stamps, starts = [], []
    for part in range(3):
        source = make(entry(CarmenSource(path=log, part=part, parts=3), f"r{part}"), Fleet(seed=seed))
        driven = list(source.sweeps())
        stamps += [sweep.stamp for sweep in driven]
        assert driven[0].odometry is not None
        starts.append(tuple(driven[0].odometry[0, 1:]))
    assert stamps == [1000.0 + i for i in range(12)]
    assert len(set(starts)) == 3  # hidden, each in a frame of its own


def test_what_cannot_be_read_of_a_log_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    log = tmp_path / "odd.log"
    row = "FLASER 2 1.0 2.0 0.0 0.0 0.0 0.0 0.0 0.0 {t} host {t}\n"
    log.write_text(row.format(t=1) + "FLASER 2 1.0\n" + row.format(t=2))
    make(entry(CarmenSource(path=log)), Fleet())
    assert "2 FLASER sweeps; skipped 1 malformed rows" in caplog.text
    assert "odd.log:2: " in caplog.text


def test_simulated_robots_of_one_scene_are_peers() -> None:
    fleet = Fleet(
        robots=(
            entry(SimSource(scene="apartment"), "a"),
            entry(SimSource(scene="apartment", route="ring"), "b"),
            entry(SimSource(scene="factory"), "c"),
            entry(CarmenSource(path=Path("x.log")), "d"),
        )
    )
    assert peers_of("a", "apartment", fleet) == {"b": "ring"}


def test_a_robot_needs_nothing_that_a_raspberry_pi_lacks() -> None:
    heavy = ["cv2", "numba", "scipy", "networkx", "zstandard", "typer", "rich"]
    program = (
        "import sys, services.robot_agent.service, services.robot_agent.app\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert shown.stdout == "[]\n"
