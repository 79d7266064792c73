"""The frames of one robot's stream that wait for their turn, and what of the stream is still missing.

Frames are taken in order, whatever order they come in. What is in no spool any more is a gap, counted and passed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from common.wire import Frame

AHEAD = 4096
"""frames kept that came before their turn; later ones are dropped here and fetched in time"""


@dataclass
class Backlog:
    next_seq: int = 0
    """next frame to be taken"""
    told: int = 0
    """frames below this are known to have been numbered by the robot"""
    lost: int = 0
    """frames below this that are not here are in no spool"""
    waiting: dict[int, Frame] = field(default_factory=dict)
    gaps: int = 0
    overrun: int = 0
    """frames dropped because they came too early"""

    def start(self, seq: int, gaps: int) -> None:
        """Begin, or begin again, at this frame, with so many gaps before it."""
        self.next_seq = self.lost = seq
        self.told, self.gaps = max(self.told, seq), gaps
        self.waiting = {each: frame for each, frame in self.waiting.items() if seq <= each < seq + AHEAD}

    def put(self, frame: Frame) -> bool:
        """Keep a frame of the stream; False when its turn has passed, or is too far off."""
        self.told = max(self.told, frame.seq + 1)
        if frame.seq >= self.next_seq + AHEAD:
            self.overrun += 1
            return False
        if frame.seq < self.next_seq:
            return False
        self.waiting[frame.seq] = frame
        return True

    def not_in_spool(self, seq: int) -> None:
        """Frames below `seq` that are not here will not come."""
        self.lost = max(self.lost, min(seq, self.next_seq + AHEAD))

    def take(self) -> Frame | None:
        """The next frame, past any gap; None while it may still come."""
        while self.next_seq not in self.waiting:
            if self.next_seq >= self.lost:
                return None
            reachable = min([self.lost, *self.waiting])
            self.gaps += reachable - self.next_seq
            self.next_seq = reachable
        self.next_seq += 1
        return self.waiting.pop(self.next_seq - 1)

    def missing(self) -> int:
        """The first frame that is not here and may be in the spool."""
        seq = max(self.next_seq, self.lost)
        while seq in self.waiting:
            seq += 1
        return seq

    def end(self) -> int:
        """One above the last frame that is here or has been taken."""
        return max([self.next_seq, *(seq + 1 for seq in self.waiting)])

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        assert all(self.next_seq <= seq < self.next_seq + AHEAD for seq in self.waiting)
