"""What a checkpoint of a SLAM instance says of itself, and when the next one is due."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Checkpoint:
    """How far an instance had come when its kernel was kept: from `seq` + 1 on it goes on as if nothing had been."""

    stream: str
    seq: int
    """the frame up to which all had been done"""
    gaps: int
    skipped: int


@dataclass
class Keeping:
    """When an instance's kernel is kept: every so many frames, or seconds if there is a frame to keep at all."""

    frames: int = 1000
    seconds: float = 60.0
    kept: int = -1
    """last frame of the checkpoint asked for last"""
    durable: int = -1
    """last frame that outlives this edge"""
    _now: float = 0.0
    _since: float = 0.0
    """when nothing was there that had not been kept, to within a tick"""

    def opened(self, seq: int, durable: bool) -> None:
        """The instance goes on behind frame `seq`, from a checkpoint that outlives this edge or not."""
        self.durable = seq if durable else -1
        self.asked(seq)

    def asked(self, seq: int) -> None:
        """The kernel is being kept as it is behind frame `seq`."""
        self.kept, self._since = seq, self._now

    def due(self, processed: int, now: float) -> bool:
        """Asked about once a second; `now` in seconds."""
        self._now, fresh = now, processed - self.kept
        if fresh <= 0:
            self._since = now
        return fresh >= self.frames or (fresh > 0 and now - self._since >= self.seconds)
