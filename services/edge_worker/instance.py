"""One robot's SLAM instance as the edge sees it: which frames it needs, has, and has taken.

Frames go to the kernel in order and one by one; what does not come is fetched from the robot's spool. A frame during
which the worker died is tried once more and then set aside, and so is the last refinement. The kernel is kept every so
often, and before it refines for the last time: from there an instance goes on whose worker died, or whose stream goes
on after all, so that its map does not depend on when an end was told. The stream of a robot that is given up ends at
the last frame that came.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import count

from common.wire import Epoch, Frame
from services.edge_worker.backlog import AHEAD, Backlog
from services.edge_worker.checkpoint import Checkpoint, Keeping
from services.edge_worker.instructions import Acknowledge, Feed, Fetch, Finish, GiveUp, Instructions, Keep, Open
from services.edge_worker.phase import Phase

IN_FLIGHT = 8
"""frames handed to the worker and not yet answered: enough to keep it busy, few to wait behind"""
DEADLY = 2
"""deaths during one frame from which on it is set aside, or while opening from which on checkpoints are left alone"""
OPENED, REFINED = -1, -2
"""stand for opening and for the last refinement among the frames during which workers have died"""
UNHEARD = "0" * 32
"""stands for the stream of a robot that was gone before anything was heard of it"""


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
    keeping: Keeping = field(default_factory=Keeping)
    phase: Phase = Phase.OPENING
    stream: str = ""
    backlog: Backlog = field(default_factory=Backlog)
    acknowledged: tuple[int, int] = (-2, -2)
    """frames told as processed and as durable"""
    last_seq: int | None = None
    """of an ended stream"""
    given_up: bool = False
    """the robot is gone and was not waited for any longer"""
    torn: bool = False
    """frames were left out that the robot may still have: this kernel is not to be gone on from"""
    keep_due: bool = False
    """nothing more is handed over before the kernel is kept"""
    in_flight: dict[int, int] = field(default_factory=dict)
    """handed over and not answered: seq → turn, in order"""
    refining: int = 0
    """turn of the last refinement"""
    fetching: int | None = None
    """first frame of the page that has been asked for"""
    curious: bool = False
    """the spool may have more than has been told of"""
    patient: bool = False
    """the spool did not have what is missing: not asked again before the next tick"""
    stirred: bool = False
    """something has come since the last tick"""
    skipped: int = 0
    foreign: int = 0
    """frames of another stream"""
    deaths: Counter[int] = field(default_factory=Counter)
    """by frame, and by OPENED and REFINED"""
    sought: bool = False
    """a newer checkpoint was looked for, as the spool no longer had what the last one lacked"""

    @property
    def processed(self) -> int:
        """The frame up to which all is done, -1 for none."""
        return min(self.in_flight, default=self.backlog.next_seq) - 1

    @property
    def turn(self) -> int | None:
        """Of what the worker was handed first and has not answered."""
        return self.refining if self.phase is Phase.FINISHING else min(self.in_flight.values(), default=None)

    def open(self) -> Instructions:
        """Start, or start again, from the newest checkpoint or the stream's first frame."""
        self.life += 1
        self.phase = Phase.OPENING
        self.backlog.start(0, 0)
        self.skipped, self.acknowledged = 0, (-2, -2)
        self.in_flight.clear()
        self.fetching, self.patient, self.torn, self.keep_due = None, False, False, False
        return [Open(self.robot, self.life, self.worker, self.stream, afresh=self.deaths[OPENED] >= DEADLY)]

    def opened(self, restored: Checkpoint | None = None, durable: bool = False) -> Instructions:
        """The kernel is there, made from a checkpoint (that outlives this edge, or not), or fresh."""
        if self.phase is not Phase.OPENING:
            return []
        if restored is not None and self.stream not in ("", restored.stream):
            return self.open()  # the stream has been told meanwhile
        self.phase, self.curious = Phase.RUNNING, True
        self.deaths.pop(OPENED, None)
        if restored is not None:
            self.stream, self.skipped = restored.stream, restored.skipped
            self.backlog.start(restored.seq + 1, restored.gaps)
        self.keeping.opened(self.processed, durable)
        return self._go_on()

    def rerouted(self, epoch: Epoch) -> None:
        """The robot stays here under another epoch, under which everything must be told again."""
        if epoch != self.epoch:
            self.epoch, self.acknowledged = epoch, (-2, -2)

    def frame_came(self, frame: Frame) -> Instructions:
        """A frame of the stream."""
        return [*self._take(frame), *self._go_on()]

    def page_came(self, stream: str, frames: Iterable[Frame], oldest: int, following: int | None) -> Instructions:
        """A page of the spool, which has nothing older than `oldest`, and goes on at frame `following`."""
        asked, self.fetching = self.fetching, None
        self.stream = self.stream or stream
        if stream != self.stream or asked is None:
            self.patient = True
            return []
        if oldest > self.backlog.missing() and self.backlog.next_seq == self.keeping.kept + 1 and not self.sought:
            self.sought = True  # the edge before may have kept meanwhile what the robot has forgotten
            return self.open()
        frames = list(frames)
        reached = following if following is not None else max((each.seq + 1 for each in frames), default=0)
        self.backlog.not_in_spool(max(oldest, reached))
        self.backlog.told = max(self.backlog.told, oldest, reached + (following is not None))
        instructions = [step for frame in frames for step in self._take(frame)]
        self.curious = False
        instructions += self._advance()
        self.patient = self.backlog.missing() <= asked
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
        self.stirred, self.sought = True, False
        return self._go_on()

    def kept_durably(self, seq: int) -> Instructions:
        """The kernel as it was behind frame `seq` lies where it outlives this edge; the next tick tells the robot."""
        self.keeping.durable = max(self.keeping.durable, seq)
        return []

    def stream_ended(self, stream: str, last_seq: int) -> Instructions:
        self.stream = self.stream or stream
        if stream != self.stream or last_seq + 1 < self.backlog.told or self.given_up:
            return []
        self.last_seq, self.backlog.told = last_seq, last_seq + 1
        if self.phase is Phase.FINAL and self.backlog.next_seq <= last_seq:
            return self.open()
        return self._go_on()

    def stream_changed(self, stream: str) -> Instructions:
        """The robot says that it begins anew: its spool was wiped."""
        if stream == self.stream or not self.stream:
            self.stream = stream
            return []
        self.stream, self.last_seq, self.backlog = stream, None, Backlog(overrun=self.backlog.overrun)
        self.deaths.clear()
        return self.open()

    def finished(self) -> Instructions:
        if self.phase is Phase.FINISHING and not self._complete():
            return self.open()  # it was refined too early: on from before that
        if self.phase is Phase.FINISHING:
            self.phase = Phase.FINAL
            return self._acknowledge()
        return []

    def give_up(self) -> Instructions:
        """The robot has been gone for too long: what has come is all there is."""
        if self.phase is not Phase.RUNNING or self._complete():
            return []
        end = self.backlog.end()
        news = not (self.given_up and self.last_seq == end - 1)
        self.stream = self.stream or UNHEARD
        self.torn = self.torn or end - self.backlog.next_seq > len(self.backlog.waiting)
        self.backlog.not_in_spool(end)
        self.last_seq, self.given_up = end - 1, True
        return [*([GiveUp(self.robot, self.life, end - 1)] if news else []), *self._go_on()]

    def came_back(self) -> Instructions:
        """The robot is there again: its stream goes on."""
        if not self.given_up:
            return []
        self.given_up, self.last_seq = False, None
        self.curious = True
        return self.open() if self.phase is Phase.FINAL or self.torn else self._go_on()

    def worker_died(self, worker: int, guilty: bool) -> Instructions:
        """The process is gone while it worked on what this instance had handed over first (`guilty`) or another's;
        `worker` is where the instance shall live now."""
        if guilty:
            self.deaths[min(self.in_flight, default=REFINED)] += 1
        if self.phase is Phase.OPENING:
            self.deaths[OPENED] += 1
        self.worker = worker
        return self.open()

    def tick(self, now: float) -> Instructions:
        """About once a second: when nothing moves, look whether the spool has more."""
        told = self.acknowledged == (self.processed, self.keeping.durable) or self.phase is Phase.OPENING
        self.keep_due = self.phase is Phase.RUNNING and not self.torn and self.keeping.due(self.processed, now)
        self.patient = False
        self.curious = self.curious or (not self.stirred and not self.in_flight)
        self.stirred = False
        return [*([] if told else self._acknowledge()), *self._go_on()]

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        self.backlog.validate()
        next_seq = self.backlog.next_seq
        assert -1 <= self.processed < next_seq or next_seq == 0
        assert len(self.in_flight) <= IN_FLIGHT
        assert list(self.in_flight) == sorted(seq for seq in self.in_flight if seq < next_seq)
        assert self.phase is Phase.RUNNING or not self.in_flight
        assert self.phase is not Phase.FINAL or self._complete()
        assert self.keeping.durable <= self.keeping.kept or self.phase is Phase.OPENING

    def _take(self, frame: Frame) -> Instructions:
        self.stream = self.stream or frame.stream
        if frame.stream != self.stream:
            self.foreign += 1
            return []
        again: Instructions = []
        if self.last_seq is not None and frame.seq > self.last_seq:
            self.last_seq, self.given_up = None, False
            again = self.open() if self.phase is Phase.FINAL or self.torn else []
        self.stirred = self.backlog.put(frame) or self.stirred
        return again

    def _go_on(self) -> Instructions:
        """Hand over what is due, fetch what is missing, finish what is complete."""
        return [*self._advance(), *self._fetch(), *self._end()]

    def _advance(self) -> Instructions:
        if self.phase is not Phase.RUNNING:
            return []
        instructions = self._keep() if self.keep_due and not self.in_flight else []
        while len(self.in_flight) < IN_FLIGHT and not self.keep_due:
            frame = self.backlog.take()
            if frame is None:
                break
            if self.deaths[frame.seq] >= DEADLY or frame.kind != "laser" or frame.scan is None:
                self.skipped += 1
                continue
            self.in_flight[frame.seq] = next(self.turns)
            instructions.append(Feed(self.robot, self.life, frame))
        if self.processed - self.acknowledged[0] >= max(1, self.window // 8):
            instructions += self._acknowledge()
        return instructions

    def _keep(self) -> Instructions:
        self.keep_due = False
        self.keeping.asked(self.processed)
        made = Checkpoint(self.stream, self.processed, self.backlog.gaps, self.skipped)
        return [Keep(self.robot, self.life, made)]

    def _fetch(self) -> Instructions:
        if self.phase is not Phase.RUNNING or self.fetching is not None or self.patient:
            return []
        backlog, missing = self.backlog, self.backlog.missing()
        near = missing == backlog.next_seq or len(backlog.waiting) < self.window
        if not near or missing >= backlog.next_seq + AHEAD or not (self.curious or missing < backlog.told):
            return []
        self.fetching = missing
        return [Fetch(self.robot, self.life, self.stream, missing)]

    def _complete(self) -> bool:
        return self.last_seq is not None and self.backlog.next_seq > self.last_seq and not self.in_flight

    def _end(self) -> Instructions:
        if self.phase is not Phase.RUNNING or not self._complete():
            return []
        self.phase, self.refining = Phase.FINISHING, next(self.turns)
        news = [] if self.processed == self.acknowledged[0] else self._acknowledge()
        kept = [] if self.torn or self.processed == self.keeping.kept else self._keep()
        return [*news, *kept, Finish(self.robot, self.life, refine=self.deaths[REFINED] < DEADLY)]

    def _acknowledge(self) -> Instructions:
        self.acknowledged = self.processed, self.keeping.durable
        return [Acknowledge(self.robot, self.life)]
