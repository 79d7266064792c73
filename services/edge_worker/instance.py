"""One robot's SLAM instance as the edge sees it: which frames it needs, has, and has taken.

    OPENING ──Opened──▶ RUNNING ──all taken──▶ FINISHING ──Finished──▶ FINAL
       ▲                   │                       │                     │
       └──── lost ─────────┴───────────────────────┴────── Revived ──────┘

Frames go to the kernel in order and one by one, whatever order they come in. What does not come is fetched from the
robot's spool; what the spool no longer has is a gap, counted. A frame during which the worker died is tried once
more in a new worker and then set aside. An instance whose worker dies starts again from the spool's first frame.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum

from common.wire import Epoch, Frame

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


@dataclass(frozen=True)
class Instruction:
    robot: str
    life: int


@dataclass(frozen=True)
class Open(Instruction):
    """Make a fresh kernel in this worker."""

    worker: int


@dataclass(frozen=True)
class Feed(Instruction):
    """Hand a frame to the kernel."""

    frame: Frame


@dataclass(frozen=True)
class Fetch(Instruction):
    """Ask the robot's spool for frames from `start` on; stream "" is whatever it has."""

    stream: str
    start: int


@dataclass(frozen=True)
class Finish(Instruction):
    """Everything is taken: let the kernel refine once more."""


@dataclass(frozen=True)
class Acknowledge(Instruction):
    """Tell the robot how far its stream has been processed."""


Instructions = list[Instruction]


@dataclass
class Instance:
    """State of one robot's instance; methods are events and return instructions."""

    robot: str
    epoch: Epoch
    worker: int
    window: int
    life: int = 0
    """counts restarts; answers of an earlier life mean nothing"""
    phase: Phase = Phase.OPENING
    stream: str = ""
    next_seq: int = 0
    """next frame to be handed to the kernel"""
    processed: int = -1
    acknowledged: int = -2
    last_seq: int | None = None
    """of an ended stream"""
    waiting: dict[int, Frame] = field(default_factory=dict)
    in_flight: deque[int] = field(default_factory=deque)
    fetching: bool = False
    stirred: bool = False
    """something has come since the last tick"""
    gaps: int = 0
    skipped: int = 0
    foreign: int = 0
    """frames of another stream"""
    overrun: int = 0
    """frames dropped because they came too early"""
    deaths: Counter[int] = field(default_factory=Counter)

    def open(self) -> Instructions:
        """Start, or start again, from the stream's first frame."""
        self.life += 1
        self.phase = Phase.OPENING
        self.next_seq, self.processed, self.acknowledged = 0, -1, -2
        self.waiting.clear()
        self.in_flight.clear()
        self.fetching = False
        return [Open(self.robot, self.life, self.worker)]

    def opened(self) -> Instructions:
        if self.phase is not Phase.OPENING:
            return []
        self.phase = Phase.RUNNING
        return [*self._fetch(), *self._go_on()]

    def frame_came(self, frame: Frame) -> Instructions:
        """A frame, from the stream or from the spool."""
        self.stream = self.stream or frame.stream
        if frame.stream != self.stream:
            self.foreign += 1
            return []
        if frame.seq >= self.next_seq + AHEAD:
            self.overrun += 1
            return []
        self.stirred = True
        if frame.seq >= self.next_seq:
            self.waiting[frame.seq] = frame
        if self.phase is Phase.FINAL and self.waiting:
            self.phase = Phase.RUNNING
        return self._go_on()

    def page_came(self, oldest: int, more: bool) -> Instructions:
        """A page of the spool has been taken in by `frame_came`; it holds nothing older than `oldest`."""
        self.fetching = False
        if self.next_seq < oldest and self.next_seq not in self.waiting and not self.in_flight:
            reachable = min([oldest, *self.waiting])
            self.gaps += reachable - self.next_seq
            self.next_seq = reachable
        instructions = self._go_on()
        if more and len(self.waiting) < self.window:
            instructions += self._fetch()
        return instructions

    def fetch_failed(self) -> Instructions:
        """The robot does not answer; the next tick asks again."""
        self.fetching = False
        return []

    def frame_done(self, seq: int, failed: bool) -> Instructions:
        """The kernel has taken (or refused) a frame."""
        if not self.in_flight or self.in_flight[0] != seq:
            return []
        self.in_flight.popleft()
        self.processed = seq
        self.skipped += failed
        self.stirred = True
        return self._go_on()

    def stream_ended(self, stream: str, last_seq: int) -> Instructions:
        self.stream = self.stream or stream
        if stream != self.stream:
            return []
        self.last_seq = last_seq
        return self._go_on()

    def stream_changed(self, stream: str) -> Instructions:
        """The robot says that it begins anew: its spool was wiped."""
        if stream == self.stream or not self.stream:
            self.stream = stream
            return []
        self.stream, self.last_seq = stream, None
        self.deaths.clear()
        return self.open()

    def finished(self) -> Instructions:
        if self.phase is not Phase.FINISHING:
            return []
        self.phase = Phase.FINAL
        return [Acknowledge(self.robot, self.life)]

    def worker_died(self, worker: int) -> Instructions:
        """The process is gone; `worker` is where the instance shall live now."""
        if self.in_flight:
            self.deaths[self.in_flight[0]] += 1
        self.worker = worker
        return self.open()

    def tick(self) -> Instructions:
        """About once a second: when nothing moves, look whether the spool has more."""
        instructions: Instructions = []
        if self.processed != self.acknowledged and self.phase is not Phase.OPENING:
            instructions += self._acknowledge()
        idle = not self.stirred and not self.in_flight
        self.stirred = False
        if self.phase is Phase.RUNNING and idle:
            instructions += self._fetch()
        return instructions

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert self.processed < self.next_seq
        assert len(self.in_flight) <= IN_FLIGHT
        assert all(seq < self.next_seq for seq in self.in_flight)
        assert all(seq >= self.next_seq for seq in self.waiting)
        assert self.phase is not Phase.FINAL or not self.in_flight

    def _go_on(self) -> Instructions:
        """Hand over what is due, fetch what is missing, finish what is complete."""
        if self.phase is not Phase.RUNNING:
            return []
        instructions: Instructions = []
        while len(self.in_flight) < IN_FLIGHT and self.next_seq in self.waiting:
            frame = self.waiting.pop(self.next_seq)
            self.next_seq += 1
            if self.deaths[frame.seq] >= DEADLY or frame.kind != "laser" or frame.scan is None:
                self.skipped += 1
                if not self.in_flight:
                    self.processed = frame.seq
                continue
            self.in_flight.append(frame.seq)
            instructions.append(Feed(self.robot, self.life, frame))
        if self.waiting and self.next_seq not in self.waiting and len(self.in_flight) < IN_FLIGHT:
            instructions += self._fetch()
        if self.processed - self.acknowledged >= max(1, self.window // 8):
            instructions += self._acknowledge()
        if self.last_seq is not None and self.next_seq > self.last_seq and not self.in_flight:
            self.processed = max(self.processed, self.last_seq)
            self.phase = Phase.FINISHING
            instructions += [*self._acknowledge(), Finish(self.robot, self.life)]
        return instructions

    def _fetch(self) -> Instructions:
        if self.fetching:
            return []
        self.fetching = True
        missing = self.next_seq
        while missing in self.waiting:
            missing += 1
        return [Fetch(self.robot, self.life, self.stream, missing)]

    def _acknowledge(self) -> Instructions:
        self.acknowledged = self.processed
        return [Acknowledge(self.robot, self.life)]
