"""Takes sweeps from a source, packs and numbers them, and commits them to the spool. Blocks: it lives in a thread."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from common.errors import BadSweep, SpoolFull
from common.sweep import Sweep
from common.wire import Frame, encode
from services.robot_agent.packing import pack
from services.robot_agent.sources.source import Source
from services.robot_agent.spool import Spool

BATCH_S = 0.05
"""a slow source's batch is handed on after this time, so that its frames are not late"""
RETRY_S = 1.0
"""between two tries to write to a full disk"""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Taken:
    """What one request yielded; all of it is committed."""

    frames: tuple[Frame, ...]
    bytes: int
    ended: bool
    """the source has no more, and `frames` is empty"""


class Collector:
    """One source's way into one spool.

    A source that can wait goes on where the spool's last run left it. `realtime` paces sweeps by their stamps: a source
    that could wait then does not.
    """

    def __init__(self, source: Source, spool: Spool, lossless: bool = False, realtime: bool = False) -> None:
        self.profile = source.profile
        self.can_wait = source.profile.can_wait and not realtime
        self.refused = 0
        """sweeps that could not be packed, or that a full disk did not take"""
        self.packed = 0
        self.busy_s = 0.0
        """time spent on packing and spooling"""
        self._source, self._spool = source, spool
        self._lossless, self._realtime = lossless, realtime
        self._stop = threading.Event()
        self._sweeps: Iterator[Sweep] | None = None
        self._count = 0
        """sweeps taken from the source"""
        self._offset: float | None = None
        """monotonic clock minus stamp, at the first paced sweep"""
        self._full = False
        """the disk did not take the last frames: said once, a log is not to fill it further"""

    def stop(self) -> None:
        """Make a request that is waiting return soon; from any thread."""
        self._stop.set()

    def take(self, limit: int) -> Taken:
        """Up to `limit` sweeps. Raises what the source raises."""
        if self._sweeps is None:
            self._sweeps = self._open()
        started = time.monotonic()
        sweeps: list[Sweep] = []
        while len(sweeps) < limit and (not sweeps or time.monotonic() - started < BATCH_S):
            sweep = next(self._sweeps, None)
            if sweep is None or not self._wait_until_due(sweep):
                break
            sweeps.append(sweep)
        if not sweeps:
            return Taken((), 0, ended=not self._stop.is_set())
        self._count += len(sweeps)
        started = time.perf_counter()
        taken = self._commit(sweeps)
        self.busy_s += time.perf_counter() - started
        self.packed += len(taken.frames)
        return taken

    def _open(self) -> Iterator[Sweep]:
        sweeps = self._source.sweeps()
        if self._source.profile.can_wait:
            for _ in range(self._spool.now().taken):
                if self._stop.is_set() or next(sweeps, None) is None:
                    break
                self._count += 1
        return sweeps

    def _wait_until_due(self, sweep: Sweep) -> bool:
        """False when stopped before."""
        if self._realtime:
            if self._offset is None:
                self._offset = time.monotonic() - sweep.stamp
            self._stop.wait(max(0.0, self._offset + sweep.stamp - time.monotonic()))
        return not self._stop.is_set()

    def _commit(self, sweeps: list[Sweep]) -> Taken:
        frames = self._pack(sweeps)
        encoded = [encode(frame) for frame in frames]
        while True:
            try:
                self._spool.append(encoded, self._count)
            except SpoolFull as error:
                if not self._full:
                    log.error("spool takes no more", extra={"reason": error})
                self._full = True
            else:
                if self._full:
                    log.info("spool takes frames again", extra={"refused": self.refused})
                self._full = False
                return Taken(tuple(frames), sum(len(data) for data in encoded), ended=False)
            if not self.can_wait:
                self.refused += len(frames)
                return Taken((), 0, ended=False)
            if self._stop.wait(RETRY_S):
                return Taken((), 0, ended=False)

    def _pack(self, sweeps: list[Sweep]) -> list[Frame]:
        frames: list[Frame] = []
        first = self._spool.now().next_seq
        for sweep in sweeps:
            try:
                frames.append(
                    pack(
                        sweep,
                        self._spool.robot,
                        self._spool.stream,
                        first + len(frames),
                        self.profile.sensor,
                        self._lossless,
                    )
                )
            except BadSweep as error:
                self.refused += 1
                log.warning("scan refused", extra={"robot": self._spool.robot, "reason": error})
        return frames
