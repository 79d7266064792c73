"""One robot's SLAM instance as the edge sees it: which frames it needs, has, and has taken.

    OPENING ──Opened──▶ RUNNING ──all taken──▶ FINISHING ──Finished──▶ FINAL
       ▲                   │                       │                     │
       └──── lost ─────────┴───────────────────────┴────── Revived ──────┘

Frames go to the kernel in order and one by one, whatever order they come in. What does not come is fetched from the
robot's spool; what the spool no longer has is a gap, counted. A frame during which the worker died is tried once
more in a new worker and then set aside. An instance whose worker dies starts again from the spool's first frame.
A stream that goes on after its end was told is not ended: it must be told again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from itertools import count

from common.wire import Epoch, Frame
from services.edge_worker.instructions import Acknowledge, Feed, Fetch, Finish, Instructions, Open

AHEAD = 4096
"""frames kept that came before their turn; later ones are dropped here and fetched in time"""
IN_FLIGHT = 8
"""frames handed to the worker and not yet answered: enough to keep it busy, few to wait behind"""
DEADLY = 2
"""deaths during one frame from which on it is set aside"""


class Phase(Enum):
    OPENING = "opening"
    RUNNING = "running"
    FINISHING = "finishing"
    FINAL = "final"


@dataclass
class Instance:
    """State of one robot's instance; methods are events and return instructions."""

    robot: str
    epoch: Epoch
    worker: int
    window: int
    life: int = 0
    """changes with each restart; answers of an earlier life mean nothing"""
    turns: Iterator[int] = field(default_factory=count)
    """numbers what is fed, over all instances of an edge"""
    phase: Phase = Phase.OPENING
    stream: str = ""
    next_seq: int = 0
    """next frame to be handed to the kernel"""
    told: int = 0
    """frames below this are known to have been numbered by the robot"""
    lost: int = 0
    """frames below this that are not here are in no spool"""
    acknowledged: int = -2
    last_seq: int | None = None
    """of an ended stream"""
    waiting: dict[int, Frame] = field(default_factory=dict)
    in_flight: dict[int, int] = field(default_factory=dict)
    """handed over and not answered: seq → turn, in order"""
    fetching: int | None = None
    """first frame of the page that has been asked for"""
    curious: bool = False
    """the spool may have more than has been told of"""
    patient: bool = False
    """the spool did not have what is missing: not asked again before the next tick"""
    stirred: bool = False
    """something has come since the last tick"""
    gaps: int = 0
    skipped: int = 0
    foreign: int = 0
    """frames of another stream"""
    overrun: int = 0
    """frames dropped because they came too early"""
    deaths: Counter[int] = field(default_factory=Counter)

    @property
    def processed(self) -> int:
        """The frame up to which all is done, -1 for none."""
        return min(self.in_flight, default=self.next_seq) - 1

    def open(self) -> Instructions:
        """Start, or start again, from the stream's first frame."""
        self.life += 1
        self.phase = Phase.OPENING
        self.next_seq, self.lost, self.acknowledged = 0, 0, -2
        self.gaps = self.skipped = 0
        self.waiting.clear()
        self.in_flight.clear()
        self.fetching, self.patient = None, False
        return [Open(self.robot, self.life, self.worker)]

    def opened(self) -> Instructions:
        if self.phase is not Phase.OPENING:
            return []
        self.phase, self.curious = Phase.RUNNING, True
        return self._go_on()

    def rerouted(self, epoch: Epoch) -> None:
        """The robot stays here under another epoch, under which everything must be told again."""
        if epoch != self.epoch:
            self.epoch, self.acknowledged = epoch, -2

    def frame_came(self, frame: Frame) -> Instructions:
        """A frame of the stream."""
        self._take(frame)
        return self._go_on()

    def page_came(self, stream: str, frames: Iterable[Frame], oldest: int, following: int | None) -> Instructions:
        """A page of the spool, which has nothing older than `oldest`, and goes on at frame `following`."""
        asked, self.fetching = self.fetching, None
        self.stream = self.stream or stream
        if stream != self.stream or asked is None:
            self.patient = True
            return []
        frames = list(frames)
        reached = following if following is not None else max((frame.seq + 1 for frame in frames), default=0)
        self.lost = max(self.lost, min(max(oldest, reached), self.next_seq + AHEAD))
        self.told = max(self.told, oldest, reached + (following is not None))
        for frame in frames:
            self._take(frame)
        self.curious = False
        instructions = self._advance()
        self.patient = self._missing() <= asked
        return [*instructions, *self._fetch(), *self._end()]

    def fetch_failed(self) -> Instructions:
        """The robot does not answer; the next tick asks again."""
        self.fetching, self.patient = None, True
        return []

    def frame_done(self, seq: int, failed: bool) -> Instructions:
        """The kernel has taken (or refused) a frame."""
        if next(iter(self.in_flight), None) != seq:
            return []
        del self.in_flight[seq]
        self.skipped += failed
        self.stirred = True
        return self._go_on()

    def stream_ended(self, stream: str, last_seq: int) -> Instructions:
        self.stream = self.stream or stream
        if stream != self.stream or last_seq + 1 < self.told:
            return []
        self.last_seq, self.told = last_seq, last_seq + 1
        if self.phase is Phase.FINAL and self.next_seq <= last_seq:
            self.phase = Phase.RUNNING
        return self._go_on()

    def stream_changed(self, stream: str) -> Instructions:
        """The robot says that it begins anew: its spool was wiped."""
        if stream == self.stream or not self.stream:
            self.stream = stream
            return []
        self.stream, self.last_seq, self.told = stream, None, 0
        self.deaths.clear()
        return self.open()

    def finished(self) -> Instructions:
        if self.phase is not Phase.FINISHING:
            return []
        self.phase = Phase.FINAL if self._complete() else Phase.RUNNING
        return [Acknowledge(self.robot, self.life), *self._go_on()]

    def worker_died(self, worker: int, guilty: bool) -> Instructions:
        """The process is gone while this instance's oldest frame was being worked on (`guilty`) or another's;
        `worker` is where the instance shall live now."""
        if guilty:
            self.deaths[min(self.in_flight)] += 1
        self.worker = worker
        return self.open()

    def tick(self) -> Instructions:
        """About once a second: when nothing moves, look whether the spool has more."""
        instructions: Instructions = []
        if self.processed != self.acknowledged and self.phase is not Phase.OPENING:
            instructions += self._acknowledge()
        self.patient = False
        self.curious = self.curious or (not self.stirred and not self.in_flight)
        self.stirred = False
        return [*instructions, *self._go_on()]

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert -1 <= self.processed < self.next_seq or self.next_seq == 0
        assert len(self.in_flight) <= IN_FLIGHT
        assert list(self.in_flight) == sorted(self.in_flight)
        assert all(seq < self.next_seq for seq in self.in_flight)
        assert all(self.next_seq <= seq < self.next_seq + AHEAD for seq in self.waiting)
        assert self.phase is not Phase.OPENING or not self.in_flight
        assert self.phase is not Phase.FINAL or self._complete()

    def _take(self, frame: Frame) -> None:
        self.stream = self.stream or frame.stream
        if frame.stream != self.stream:
            self.foreign += 1
            return
        self.told = max(self.told, frame.seq + 1)
        if self.last_seq is not None and frame.seq > self.last_seq:
            self.last_seq = None
            self.phase = Phase.RUNNING if self.phase is Phase.FINAL else self.phase
        if frame.seq >= self.next_seq + AHEAD:
            self.overrun += 1
        elif frame.seq >= self.next_seq:
            self.stirred = True
            self.waiting[frame.seq] = frame

    def _go_on(self) -> Instructions:
        """Hand over what is due, fetch what is missing, finish what is complete."""
        return [*self._advance(), *self._fetch(), *self._end()]

    def _advance(self) -> Instructions:
        if self.phase is not Phase.RUNNING:
            return []
        instructions: Instructions = []
        while len(self.in_flight) < IN_FLIGHT:
            frame = self.waiting.pop(self.next_seq, None)
            if frame is None:
                if self.next_seq >= self.lost:
                    break
                reachable = min([self.lost, *self.waiting])
                self.gaps += reachable - self.next_seq
                self.next_seq = reachable
                continue
            self.next_seq += 1
            if self.deaths[frame.seq] >= DEADLY or frame.kind != "laser" or frame.scan is None:
                self.skipped += 1
                continue
            self.in_flight[frame.seq] = next(self.turns)
            instructions.append(Feed(self.robot, self.life, frame))
        if self.processed - self.acknowledged >= max(1, self.window // 8):
            instructions += self._acknowledge()
        return instructions

    def _missing(self) -> int:
        """The first frame that is not here and may be in the spool."""
        missing = max(self.next_seq, self.lost)
        while missing in self.waiting:
            missing += 1
        return missing

    def _fetch(self) -> Instructions:
        if self.phase is not Phase.RUNNING or self.fetching is not None or self.patient:
            return []
        missing = self._missing()
        near = missing == self.next_seq or len(self.waiting) < self.window
        if not near or missing >= self.next_seq + AHEAD or not (self.curious or missing < self.told):
            return []
        self.fetching = missing
        return [Fetch(self.robot, self.life, self.stream, missing)]

    def _complete(self) -> bool:
        return self.last_seq is not None and self.next_seq > self.last_seq and not self.in_flight

    def _end(self) -> Instructions:
        if self.phase is not Phase.RUNNING or not self._complete():
            return []
        self.phase = Phase.FINISHING
        news = self._acknowledge() if self.processed != self.acknowledged else []
        return [*news, Finish(self.robot, self.life)]

    def _acknowledge(self) -> Instructions:
        self.acknowledged = self.processed
        return [Acknowledge(self.robot, self.life)]
