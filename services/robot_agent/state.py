"""What a robot agent decides: events in, instructions out; no clock, no network, no disk.

    COLLECTING --SourceEnded--> SERVING --LingerOver (only with exit_when_processed)--> FINISHED

Flow. A source that can wait is asked for as many sweeps as the edge's window has room for, and for none when it is
`window` frames ahead of what the edge has processed; before the first ack the fleet's default window counts. A live
source is asked again at once whatever the edge does. One request is outstanding at most.

Acks. Only the present stream's count, and never one of an older epoch than one that has been heard: a hand-over fences
the old edge off. `processed` may fall, because a new edge or a restarted instance restores a checkpoint and asks for
the rest from the spool; nothing is forgotten before it is durable, so nothing is lost. `durable` never falls.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from common.wire import Ack, Epoch

BATCH = 16
"""sweeps asked of a waiting source at once"""


class Phase(Enum):
    COLLECTING = "collecting"
    SERVING = "serving"
    """the source has ended; the spool still answers"""
    FINISHED = "finished"


# Events


@dataclass(frozen=True)
class Started:
    pass


@dataclass(frozen=True)
class Collected:
    """The answer to one Collect: all frames up to number `last_seq` are committed."""

    last_seq: int


@dataclass(frozen=True)
class SourceEnded:
    """The answer to a Collect that found no more sweeps."""


@dataclass(frozen=True)
class AckReceived:
    ack: Ack


@dataclass(frozen=True)
class RouteChanged:
    """The scheduler's word on who runs this robot."""

    slam_edge: str
    epoch: Epoch


@dataclass(frozen=True)
class BackfillServed:
    frames: int


@dataclass(frozen=True)
class LingerOver:
    """The time asked for by the Linger of this number has passed."""

    number: int


Event = Started | Collected | SourceEnded | AckReceived | RouteChanged | BackfillServed | LingerOver


# Instructions


@dataclass(frozen=True)
class Collect:
    """Take up to `limit` sweeps, spool them, publish their frames, and come back with Collected or SourceEnded."""

    limit: int


@dataclass(frozen=True)
class Trim:
    """Forget frames up to `durable`."""

    durable: int


@dataclass(frozen=True)
class AnnounceEnd:
    last_seq: int


@dataclass(frozen=True)
class Linger:
    """Come back with LingerOver of this number after `robot.linger_s`."""

    number: int


@dataclass(frozen=True)
class Finish:
    """Nobody needs this robot any more: exit."""


Instruction = Collect | Trim | AnnounceEnd | Linger | Finish

TRANSITIONS: dict[Phase, dict[type[Event], Phase]] = {
    Phase.COLLECTING: {SourceEnded: Phase.SERVING},
    Phase.SERVING: {LingerOver: Phase.FINISHED},
    Phase.FINISHED: {},
}


@dataclass
class AgentState:
    stream: str
    window: int
    """frames that a waiting source may be ahead of `processed`; until the first ack, the fleet's default"""
    can_wait: bool
    last_seq: int = -1
    exit_when_processed: bool = False
    phase: Phase = Phase.COLLECTING
    collecting: bool = False
    """a Collect is outstanding"""
    processed: int = -1
    durable: int = -1
    epoch: Epoch = (0, 0)
    """latest heard, in an ack or a routing table"""
    edge: str = ""
    """who runs this robot's SLAM instance, as far as heard"""
    lingers: int = 0
    backfilled: int = 0
    stale_acks: int = 0
    """acks of an older epoch or of another edge of the same epoch"""
    foreign_acks: int = 0
    """acks of another stream"""
    false_acks: int = 0
    """acks of frames that this spool has never numbered"""

    def handle(self, event: Event) -> list[Instruction]:
        """Take one event. Events that mean nothing in the present phase change nothing."""
        match event:
            case Started():
                pass
            case Collected(last_seq):
                self.collecting = False
                self.last_seq = last_seq
            case SourceEnded():
                self.collecting = False
                return self._ended()
            case AckReceived(ack):
                return self._acked(ack)
            case RouteChanged(edge, epoch):
                self._routed(edge, epoch)
            case BackfillServed(frames):
                self.backfilled += frames
                return self._linger()
            case LingerOver(number):
                return self._lingered(number)
        return self._collect()

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert -1 <= self.processed <= self.last_seq, "the edge has processed what was never numbered"
        assert -1 <= self.durable <= self.last_seq, "what was never numbered is durable"
        assert self.window >= 1, "the window lets nothing through"
        assert not (self.collecting and self.phase is not Phase.COLLECTING), "an ended source was asked"

    @property
    def ended(self) -> bool:
        return self.phase is not Phase.COLLECTING

    @property
    def ignored(self) -> int:
        """Acks that did not count."""
        return self.stale_acks + self.foreign_acks + self.false_acks

    @property
    def room(self) -> int:
        """Frames that may still be sent before the edge has processed more."""
        return max(0, self.processed + self.window - self.last_seq)

    def _collect(self) -> list[Instruction]:
        limit = min(self.room, BATCH) if self.can_wait else 1
        if self.phase is not Phase.COLLECTING or self.collecting or limit == 0:
            return []
        self.collecting = True
        return [Collect(limit)]

    def _ended(self) -> list[Instruction]:
        if not self._move(SourceEnded):
            return []
        return [AnnounceEnd(self.last_seq), *self._linger()]

    def _acked(self, ack: Ack) -> list[Instruction]:
        if not self._credible(ack):
            return []
        self.edge, self.epoch = ack.edge, ack.epoch
        news = ack.processed != self.processed
        self.processed, self.window = ack.processed, max(1, ack.window)
        instructions = self._collect()
        if ack.durable > self.durable:
            self.durable = ack.durable
            instructions.append(Trim(ack.durable))
        return instructions + (self._linger() if news else [])

    def _credible(self, ack: Ack) -> bool:
        if ack.stream != self.stream:
            self.foreign_acks += 1
        elif ack.epoch < self.epoch or (ack.epoch == self.epoch and self.edge not in ("", ack.edge)):
            self.stale_acks += 1
        elif not (-1 <= ack.processed <= self.last_seq and -1 <= ack.durable <= self.last_seq):
            self.false_acks += 1
        else:
            return True
        return False

    def _routed(self, edge: str, epoch: Epoch) -> None:
        if epoch > self.epoch:
            self.epoch, self.edge = epoch, edge

    def _linger(self) -> list[Instruction]:
        """(Re)start the wait for late queries, or call it off when the edge no longer has everything."""
        if self.phase is not Phase.SERVING or not self.exit_when_processed:
            return []
        self.lingers += 1
        return [Linger(self.lingers)] if self.processed == self.last_seq else []

    def _lingered(self, number: int) -> list[Instruction]:
        if number != self.lingers or not self._move(LingerOver):
            return []
        return [Finish()]

    def _move(self, event: type[Event]) -> bool:
        """Whether the table has a transition for this event; it is taken then."""
        target = TRANSITIONS[self.phase].get(event)
        self.phase = target or self.phase
        return target is not None
