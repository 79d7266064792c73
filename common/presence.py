"""Who is there, by liveliness tokens, and for how long somebody has been missed.

When the router is lost everybody seems to be gone. So nobody is missed while it is away, and afterwards absence counts
from its return.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RobotSeen:
    """A robot has come, or gone; `now` in seconds of any steady clock, as all times here."""

    robot: str
    alive: bool
    now: float


@dataclass(frozen=True)
class Linked:
    """The router is there, or is lost."""

    up: bool
    now: float


@dataclass
class Presence:
    """One peer's."""

    alive: bool = True
    since: float = 0.0
    """when that became so"""


@dataclass
class RouterLink:
    """Whether the router is there."""

    up: bool = True
    since: float = float("-inf")

    def changed(self, up: bool, now: float) -> None:
        if up != self.up:
            self.up, self.since = up, now

    def up_for(self, now: float) -> float:
        """Seconds for which the router has been there; 0 while it is not."""
        return now - self.since if self.up else 0.0

    def missed_for(self, peer: Presence, now: float) -> float:
        """Seconds for which the peer has been away while the router was there all along."""
        return 0.0 if peer.alive else min(now - peer.since, self.up_for(now))


def seen(known: dict[str, Presence], name: str, alive: bool, now: float) -> None:
    """Note that a peer has come or gone; a token told twice changes nothing."""
    before = known.get(name)
    if before is None or before.alive != alive:
        known[name] = Presence(alive, now)
