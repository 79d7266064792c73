"""The spool: nothing committed is lost, whatever kills the process, and it never grows beyond its limit."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from common.errors import SpoolFull, UsageError
from services.robot_agent.spool import Spool

MB = 2**20


def payload(seq: int, size: int = 100) -> bytes:
    return random.Random(seq).randbytes(size)


def test_a_reopened_spool_continues_its_stream(tmp_path: Path) -> None:
    with Spool(tmp_path / "r1.spool", "r1", MB) as spool:
        stream = spool.stream
        assert spool.append([b"a", b"b"], taken=3) == 0
    with Spool(tmp_path / "r1.spool", "r1", MB) as spool:
        assert spool.stream == stream
        assert spool.now().taken == 3
        assert spool.append([b"c"], taken=4) == 2
        assert spool.read(0, MB) == ([(0, b"a"), (1, b"b"), (2, b"c")], None)


def test_numbers_go_on_when_everything_was_durable(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        spool.append([b"a", b"b"], taken=2)
        spool.trim(1)
        assert spool.read(0, MB) == ([], None)
        assert (spool.now().oldest, spool.now().bytes, spool.now().frames) == (2, 0, 0)
    with Spool(tmp_path / "s", "r1", MB) as spool:
        assert (spool.now().durable, spool.now().oldest) == (1, 2)
        assert spool.append([b"c"], taken=3) == 2


def test_a_full_spool_drops_the_oldest_and_counts_only_what_is_lost(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", limit_bytes=1000, keep_durable=True) as spool:
        for seq in range(10):
            spool.append([payload(seq)], taken=seq + 1)
        spool.trim(3)
        spool.append([payload(seq) for seq in range(10, 16)], taken=16)
        now = spool.now()
        assert (now.oldest, now.frames, now.bytes) == (6, 10, 1000)
        assert now.dropped == 2  # 4 and 5; 0 to 3 were durable


def test_the_newest_frame_stays_even_when_it_is_larger_than_the_limit(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", limit_bytes=10) as spool:
        spool.append([payload(0), payload(1)], taken=2)
        assert spool.read(0, MB) == ([(1, payload(1))], None)


def test_a_long_spool_is_trimmed_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.robot_agent.spool.TRIM_FRAMES", 3)
    with Spool(tmp_path / "s", "r1", MB) as spool:
        spool.append([payload(seq) for seq in range(20)], taken=20)
        spool.trim(17)
        assert (spool.now().oldest, spool.now().frames, spool.now().durable) == (18, 2, 17)


def test_a_recording_keeps_what_is_durable(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB, keep_durable=True) as spool:
        spool.append([b"a", b"b"], taken=2)
        spool.trim(1)
        assert len(spool.read(0, MB)[0]) == 2


def test_pages_are_bounded_and_lead_to_each_other(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        spool.append([payload(seq) for seq in range(10)], taken=10)
        page, following = spool.read(2, limit_bytes=350)
        assert ([seq for seq, _ in page], following) == ([2, 3, 4], 5)
        page, following = spool.read(5, limit_bytes=MB, end=6)
        assert ([seq for seq, _ in page], following) == ([5, 6], None)
        page, following = spool.read(9, limit_bytes=1)
        assert ([seq for seq, _ in page], following) == ([9], None)


def test_a_second_process_is_refused(tmp_path: Path) -> None:
    with (
        Spool(tmp_path / "s", "r1", MB),
        pytest.raises(UsageError, match="another process has this spool open"),
    ):
        Spool(tmp_path / "s", "r1", MB)
    Spool(tmp_path / "s", "r1", MB).close()


def test_another_robots_spool_is_refused(tmp_path: Path) -> None:
    Spool(tmp_path / "s", "r1", MB).close()
    with pytest.raises(UsageError, match="robot 'r1'"):
        Spool(tmp_path / "s", "r2", MB)


@pytest.mark.parametrize("where", ["file/r1.spool", "folder"])
def test_a_place_that_cannot_be_written_is_refused_by_name(tmp_path: Path, where: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.lock").mkdir()
    with pytest.raises(UsageError, match=rf"{where}: .*; give a --spool that can be written"):
        Spool(tmp_path / where, "r1", MB)


def test_what_is_appended_is_on_the_disk_before_it_is_published(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        (synchronous,) = spool._db.execute("PRAGMA synchronous").fetchone()
        assert synchronous == 2  # FULL: each commit waits for the disk, so that a power cut gives no number twice


@pytest.mark.parametrize("damage", ["overwritten", "pages", "foreign"])
def test_a_damaged_file_is_moved_aside_and_a_new_stream_begins(
    tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "r1.spool"
    with Spool(path, "r1", MB) as spool:
        old = spool.stream
        spool.append([payload(seq, 1000) for seq in range(100)], taken=100)
    if damage == "overwritten":
        path.write_bytes(b"this is no database" * 100)
    elif damage == "pages":
        data = bytearray(path.read_bytes())
        data[8192:40960] = os.urandom(32768)
        path.write_bytes(data)
    else:
        path.unlink()
        sqlite3.connect(path).execute("CREATE TABLE somebody_elses (x)").connection.close()
    with Spool(path, "r1", MB) as spool:
        assert spool.stream != old
        assert spool.append([b"a"], taken=1) == 0
    assert (tmp_path / "r1.spool.damaged-1").exists()
    assert "moved aside" in caplog.text


def test_a_full_disk_stores_nothing_and_says_so(tmp_path: Path) -> None:
    with Spool(tmp_path / "s", "r1", MB) as spool:
        spool.append([b"a"], taken=1)
        (pages,) = spool._db.execute("PRAGMA page_count").fetchone()
        spool._db.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(SpoolFull, match="free some disk"):
            spool.append([payload(1, 100_000)], taken=2)
        spool._db.execute("PRAGMA max_page_count = 100000")
        assert spool.append([b"b"], taken=2) == 1
        assert spool.read(0, MB) == ([(0, b"a"), (1, b"b")], None)


WRITER = """
    import random, sys
    from pathlib import Path
    from services.robot_agent.spool import Spool

    spool = Spool(Path(sys.argv[1]), "r1", 2**30)
    while True:
        first = spool.now().next_seq
        batch = [random.Random(first + i).randbytes(700) for i in range(1 + first % 5)]
        spool.append(batch, taken=first + len(batch))
        print(first + len(batch) - 1, flush=True)  # stands for publishing: it comes after the commit
        if first % 7 == 0:
            spool.trim(first - 300)
"""


def test_kill_minus_9_at_any_instant_loses_no_published_frame_and_gives_no_number_twice(tmp_path: Path) -> None:
    path = tmp_path / "r1.spool"
    published, streams = -1, set()
    for kill_after in (1, 3, 40, 400, 1000):
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(WRITER), str(path)], stdout=subprocess.PIPE, text=True
        ) as writer:
            assert writer.stdout is not None
            for _ in range(kill_after):
                published = int(writer.stdout.readline())
            writer.send_signal(signal.SIGKILL)
            rest = writer.stdout.read().split("\n")
        published = max([published, *(int(line) for line in rest[:-1])])  # a last line without its end was not written
        with Spool(path, "r1", 2**30) as spool:
            now = spool.now()
            streams.add(spool.stream)
            frames, _ = spool.read(0, 2**30)
        assert published <= now.next_seq - 1 <= published + 5  # at most the batch that was on its way
        assert now.taken == now.next_seq
        assert [seq for seq, _ in frames] == list(range(now.durable + 1, now.next_seq))
        assert all(data == payload(seq, 700) for seq, data in frames)
    assert len(streams) == 1


class SpoolMachine(RuleBasedStateMachine):
    """A spool against a plain list, through appends, trims, reads and reopenings."""

    LIMIT = 2000
    home: Path

    @initialize(keep=st.booleans())
    def begin(self, keep: bool) -> None:
        self.path = Path(tempfile.mkdtemp(dir=self.home)) / "s"
        self.keep = keep
        self.spool = Spool(self.path, "r1", self.LIMIT, keep)
        self.stream = self.spool.stream
        self.frames: dict[int, bytes] = {}
        self.next = self.dropped = 0
        self.durable = -1

    @rule(sizes=st.lists(st.integers(1, 900), min_size=0, max_size=5))
    def append(self, sizes: list[int]) -> None:
        batch = [payload(self.next + i, size) for i, size in enumerate(sizes)]
        assert self.spool.append(batch, taken=self.next + len(batch)) == self.next
        for data in batch:
            self.frames[self.next] = data
            self.next += 1
        while sum(map(len, self.frames.values())) > self.LIMIT and len(self.frames) > 1:
            oldest = min(self.frames)
            del self.frames[oldest]
            self.dropped += oldest > self.durable

    @precondition(lambda self: self.next > 0)
    @rule(data=st.data())
    def trim(self, data: st.DataObject) -> None:
        durable = data.draw(st.integers(-1, self.next - 1))
        self.spool.trim(durable)
        self.durable = max(self.durable, durable)
        if not self.keep:
            self.frames = {seq: frame for seq, frame in self.frames.items() if seq > self.durable}

    @rule(start=st.integers(0, 40), limit=st.integers(1, 1500))
    def read_in_pages(self, start: int, limit: int) -> None:
        found, cursor = [], start
        while cursor is not None:
            page, following = self.spool.read(cursor, limit)
            assert following is None or following > cursor
            assert len(page) <= 1 or sum(len(data) for _, data in page) <= limit
            found, cursor = found + page, following
        assert found == [(seq, data) for seq, data in sorted(self.frames.items()) if seq >= start]

    @rule()
    def reopen(self) -> None:
        before = self.spool.now()
        self.spool.close()
        self.spool = Spool(self.path, "r1", self.LIMIT, self.keep)
        assert (self.spool.stream, self.spool.now()) == (self.stream, before)

    @invariant()
    def agrees(self) -> None:
        if not hasattr(self, "spool"):
            return
        now = self.spool.now()
        assert (now.next_seq, now.durable, now.dropped) == (self.next, self.durable, self.dropped)
        assert now.frames == len(self.frames)
        assert now.bytes == sum(map(len, self.frames.values()))
        assert now.oldest == min(self.frames, default=self.next)

    def teardown(self) -> None:
        if hasattr(self, "spool"):
            self.spool.close()


def test_a_spool_behaves_like_a_bounded_list_that_survives(tmp_path: Path) -> None:
    class Machine(SpoolMachine):
        home = tmp_path

    Machine.TestCase.settings = settings(max_examples=30, stateful_step_count=25, deadline=None)
    Machine.TestCase("runTest").runTest()
