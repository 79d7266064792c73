"""Replays the frames of an earlier run's spool."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from common.errors import BadFile, BadMessage
from common.sweep import Sweep
from common.wire import Frame, decode
from services.robot_agent import packing
from services.robot_agent.sources.source import SourceProfile
from services.robot_agent.spool import check


class Recording:
    """The laser frames of a spool file, which is opened for reading only and may belong to another robot.

    Frames packed again come out as they were: metres of whole counts round to the same counts. Raises BadFile when the
    file is no spool, is damaged, or lacks its beginning (`robot.record` keeps it).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._db = _open(path)
        first = next(self._frames(), None)
        if first is not None and first.seq > 0:
            raise BadFile(
                f"{path}: begins with frame {first.seq}, the earlier ones are gone; "
                "record with robot.record = true and a robot.spool_mb that holds all"
            )
        scan = first.scan if first is not None else None
        self.profile = SourceProfile(
            name=f"recording {path.name}",
            sensor=first.sensor if first is not None else "",
            range_max=scan.range_max if scan is not None else 0.0,
            can_wait=True,
        )

    def sweeps(self) -> Iterator[Sweep]:
        for frame in self._frames():
            sweep = packing.unpack(frame)
            if sweep is not None:
                yield sweep

    def _frames(self) -> Iterator[Frame]:
        try:
            for seq, data in self._db.execute("SELECT seq, data FROM frames ORDER BY seq"):
                frame = decode(data, sender=f"{self.path}, frame {seq}")
                if not isinstance(frame, Frame):
                    raise BadFile(f"{self.path}: entry {seq} is a {type(frame).__name__}, not a Frame")
                yield frame
        except (sqlite3.DatabaseError, BadMessage) as error:
            raise BadFile(f"{self.path}: {error}; is it a spool of this version?") from error


def _open(path: Path) -> sqlite3.Connection:
    try:
        db = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)
        check(db)
    except sqlite3.DatabaseError as error:
        raise BadFile(f"{path}: {error}; a recording is the spool file of an earlier run") from error
    return db
