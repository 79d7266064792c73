"""A bounded store of frames on disk: what is not durable elsewhere survives here, and a kept spool is a recording.

One sqlite file holds one stream. Frames lie in it encoded as they go on the wire. `append` returns once they are
committed and on the disk (synchronous=FULL), so that nothing is published that a kill -9 or a power cut could undo. A
number given twice would be worse than a frame lost: the edge takes the second frame for the first, and throws it away.
"""

from __future__ import annotations

import fcntl
import logging
import sqlite3
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO

from common.errors import BadFile, SpoolFull, UsageError

TRIM_FRAMES = 2000
"""frames trimmed in one transaction"""
SCHEMA_VERSION = 1
APPLICATION_ID = 0x5245_4353
"""marks the sqlite file as ours ("RECS")"""

SCHEMA = f"""
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
CREATE TABLE stream (
    robot TEXT NOT NULL,
    uuid TEXT NOT NULL,
    next_seq INTEGER NOT NULL,
    taken INTEGER NOT NULL,
    durable INTEGER NOT NULL,
    dropped INTEGER NOT NULL
);
CREATE TABLE frames (seq INTEGER PRIMARY KEY, data BLOB NOT NULL);
"""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Spooled:
    """What a spool holds at one instant."""

    next_seq: int
    """number of the next frame"""
    taken: int
    """sweeps taken from the source so far, refused ones included: where a repeatable source goes on"""
    durable: int
    """last frame known to be durable elsewhere, -1 for none"""
    dropped: int
    """frames lost to the limit before they were durable"""
    frames: int
    bytes: int
    """payload; the file itself is up to 1.4 times as large, and 4 MB of write-ahead log"""
    oldest: int
    """first frame still there; `next_seq` when there is none"""


class Spool:
    """One robot's frames on disk, used by one process; any of its threads may call any method.

    Raises UsageError when it cannot be written, another process has it open or it belongs to another robot. A file that
    is no sound spool is moved aside and a new stream begins.
    """

    def __init__(self, path: Path, robot: str, limit_bytes: int, keep_durable: bool = False) -> None:
        self.path, self.robot, self.limit_bytes, self.keep_durable = path, robot, limit_bytes, keep_durable
        self._guard = threading.Lock()
        self._lock = _lock(path)
        try:
            with _faults(path):
                self._db = self._open()
                self.stream, self._now = self._load()
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        with self._guard:
            self._db.close()
            self._lock.close()

    def now(self) -> Spooled:
        return self._now

    def append(self, frames: Sequence[bytes], taken: int) -> int:
        """Store encoded frames under the next numbers and return the first of them; `taken` is kept with them.

        Raises SpoolFull, with nothing stored, when the disk is full.
        """
        with self._transaction() as now:
            end = now.next_seq + len(frames)
            self._db.executemany("INSERT INTO frames VALUES (?, ?)", enumerate(frames, now.next_seq))
            grown = now.bytes + sum(len(data) for data in frames)
            gone, freed, lost = self._drop_oldest(grown - self.limit_bytes, end - 1, now.durable)
            self._save(
                replace(
                    now,
                    next_seq=end,
                    taken=taken,
                    dropped=now.dropped + lost,
                    frames=now.frames + len(frames) - gone,
                    bytes=grown - freed,
                    oldest=now.oldest + gone,
                )
            )
        return now.next_seq

    def trim(self, durable: int) -> None:
        """Forget all frames up to `durable`, or only remember that they are durable when the spool is a recording.

        Works in slices: a spool that has waited long for its edge must not keep the next frame out for seconds.
        """
        while self._trim_slice(durable):
            pass

    def read(self, start: int, limit_bytes: int, end: int | None = None) -> tuple[list[tuple[int, bytes]], int | None]:
        """Frames from number `start` to `end` (None: all) that fit into `limit_bytes`, at least one where there is one.

        Returns (number, frame) pairs and the number to go on with, None at the end. Raises BadFile on a damaged file.
        """
        page: list[tuple[int, bytes]] = []
        last = self._now.next_seq - 1 if end is None else end
        query = "SELECT seq, data FROM frames WHERE seq BETWEEN ? AND ? ORDER BY seq"
        with self._guard, _faults(self.path):
            for seq, data in self._db.execute(query, (start, last)):
                limit_bytes -= len(data)
                if page and limit_bytes < 0:
                    return page, seq
                page.append((seq, data))
        return page, None

    def _trim_slice(self, durable: int) -> bool:
        """Whether there is more to trim."""
        with self._transaction() as now:
            end = durable if self.keep_durable else min(durable, max(now.oldest, now.durable) + TRIM_FRAMES)
            if end <= now.durable:
                return False
            gone = freed = 0
            if not self.keep_durable:
                query = "SELECT COUNT(*), COALESCE(SUM(LENGTH(data)), 0) FROM frames WHERE seq <= ?"
                gone, freed = self._db.execute(query, (end,)).fetchone()
                self._db.execute("DELETE FROM frames WHERE seq <= ?", (end,))
            self._save(
                replace(
                    now,
                    durable=end,
                    frames=now.frames - gone,
                    bytes=now.bytes - freed,
                    oldest=now.oldest + gone,
                )
            )
        return end < durable

    def _drop_oldest(self, excess: int, newest: int, durable: int) -> tuple[int, int, int]:
        """Delete the oldest frames until `excess` bytes are free, never the newest: (frames, bytes, not durable)."""
        gone = freed = lost = 0
        if excess > 0:
            query = "SELECT seq, LENGTH(data) FROM frames WHERE seq < ? ORDER BY seq"
            seq = -1
            for seq, size in self._db.execute(query, (newest,)):
                gone, freed, lost = gone + 1, freed + size, lost + (seq > durable)
                if freed >= excess:
                    break
            self._db.execute("DELETE FROM frames WHERE seq <= ?", (seq,))
        return gone, freed, lost

    def _save(self, state: Spooled) -> None:
        query = "UPDATE stream SET next_seq = ?, taken = ?, durable = ?, dropped = ?"
        self._db.execute(query, (state.next_seq, state.taken, state.durable, state.dropped))
        self._pending = state

    @contextmanager
    def _transaction(self) -> Iterator[Spooled]:
        """All or nothing, also of what `now` tells."""
        with self._guard, _faults(self.path):
            self._pending = self._now
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._now
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
            self._now = self._pending

    def _open(self) -> sqlite3.Connection:
        try:
            return _connect(self.path)
        except sqlite3.OperationalError as error:
            raise UsageError(f"{self.path}: {error}; give a --spool that can be written") from error
        except sqlite3.DatabaseError as error:
            aside = _move_aside(self.path)
            log.error(
                "spool is damaged: moved aside, a new stream begins; what no edge had taken is in the damaged file",
                extra={"spool": self.path, "aside": aside, "reason": error},
            )
            return _connect(self.path)

    def _load(self) -> tuple[str, Spooled]:
        with self._guard:
            row = self._db.execute("SELECT robot, uuid, next_seq, taken, durable, dropped FROM stream").fetchone()
            if row is None:
                row = (self.robot, uuid.uuid4().hex, 0, 0, -1, 0)
                self._db.execute("INSERT INTO stream VALUES (?, ?, ?, ?, ?, ?)", row)
            frames, size, oldest = self._db.execute(
                "SELECT COUNT(*), COALESCE(SUM(LENGTH(data)), 0), MIN(seq) FROM frames"
            ).fetchone()
        robot, stream, next_seq, taken, durable, dropped = row
        if robot != self.robot:
            self._db.close()
            raise UsageError(
                f"{self.path}: this spool is robot {robot!r}'s, not {self.robot!r}'s; give another --spool"
            )
        oldest = next_seq if oldest is None else oldest
        return stream, Spooled(next_seq, taken, durable, dropped, frames, size, oldest)


def _lock(path: Path) -> IO[str]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open(path.with_name(path.name + ".lock"), "a")  # noqa: SIM115 - held until close
    except OSError as error:
        raise UsageError(f"{path}: {error}; give a --spool that can be written") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise UsageError(f"{path}: another process has this spool open; stop it or give another --spool") from None
    return file


def _connect(path: Path) -> sqlite3.Connection:
    """An open, sound spool. Raises sqlite3.DatabaseError when the file is none."""
    db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        if db.execute("SELECT COUNT(*) FROM sqlite_master").fetchone() == (0,):
            db.executescript(f"BEGIN; {SCHEMA} COMMIT;")
        check(db)
    except BaseException:
        db.close()
        raise
    return db


def check(db: sqlite3.Connection) -> None:
    """Raises sqlite3.DatabaseError, saying why, when this is no sound spool of this version."""
    for name, wanted in (("application_id", APPLICATION_ID), ("user_version", SCHEMA_VERSION)):
        (found,) = db.execute(f"PRAGMA {name}").fetchone()
        if found != wanted:
            raise sqlite3.DatabaseError(f"{name} is {found}, expected {wanted}")
    (verdict,) = db.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise sqlite3.DatabaseError(verdict)


def _move_aside(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    for suffix in ("", "-wal", "-shm"):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))
    return aside


@contextmanager
def _faults(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:
        raise SpoolFull(f"{path}: {error}; free some disk, or lower robot.spool_mb") from error
    except sqlite3.DatabaseError as error:
        raise BadFile(f"{path}: {error}; start the robot again to move the damaged spool aside") from error
