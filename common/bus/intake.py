"""What comes in is decoded and checked against its key here; what is refused is counted against its sender."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from common.bus import keys
from common.errors import BadMessage, UsageError
from common.wire import Message, cloud, decode, edge, pages, robot, scheduler
from common.wire.limits import MAX_MESSAGE_BYTES

log = logging.getLogger(__name__)

PROBLEMS = 32
"""refusals kept as text"""
QUIET_S = 60.0
"""a sender's refusals are logged once in this time; all are counted"""
MAX_SENDERS = 1024
"""senders that are counted apart; a flood of invented names counts as one"""

TIERS = ("robot", "edge", "cloud", "scheduler")
TOLD_BY: dict[type[Message], tuple[str, ...]] = {
    **dict.fromkeys((robot.Frame, robot.EndOfStream, robot.RobotProfile, robot.RobotStatus), ("robot",)),
    **dict.fromkeys((edge.Ack, edge.PoseUpdate, edge.MapNotice, edge.EdgeMapNotice), ("edge",)),
    **dict.fromkeys((edge.Claims, edge.EdgeStatus, pages.TrajectoryPage), ("edge",)),
    **dict.fromkeys((edge.Verdicts, pages.TilePage), ("edge", "cloud")),
    **dict.fromkeys((cloud.Transforms, cloud.GlobalMapNotice, cloud.CloudStatus), ("cloud",)),
    **dict.fromkeys((scheduler.Routes, scheduler.Plan), ("scheduler",)),
    **dict.fromkeys((scheduler.OverlapMatrix, scheduler.SchedulerStatus), ("scheduler",)),
    pages.FramePage: ("robot",),
}
"""kind → tiers under whose keys it may come: receivers tell messages apart by kind, whatever the key"""


@dataclass(frozen=True)
class Received:
    """A message under the key that it came by."""

    key: str
    message: Message
    size: int
    """bytes on the wire"""
    sent_s: float = 0.0
    """the sender's clock when it was put, seconds since 1970; 0 where it is not known"""


class Payload(Protocol):
    def __len__(self) -> int: ...
    def to_bytes(self) -> bytes: ...


@dataclass
class Counters:
    """Of one bus since it was opened."""

    sent: int = 0
    sent_bytes: int = 0
    unconnected: int = 0
    """messages put while there was no router: lost"""
    received: int = 0
    received_bytes: int = 0
    dropped: int = 0
    """received, but pushed out by newer ones before they were taken"""
    served: int = 0
    failed: int = 0
    """queries answered with an error"""
    refused: Counter[str] = field(default_factory=Counter)
    """sender → messages refused"""

    def flat(self) -> dict[str, int]:
        """All as one mapping, for a status message."""
        plain = {name: value for name, value in self.__dict__.items() if isinstance(value, int)}
        return {**plain, "refused": self.refused.total()}


def contradiction(key: str, message: Message) -> str | None:
    """How the message's kind, or its own word on robot or edge, differs from its key's, None when it does not."""
    kind, tier = type(message), sender_of(key).partition("/")[0]
    if kind in TOLD_BY and tier in TIERS and tier not in TOLD_BY[kind]:
        return f"{kind.__name__} is no word of the tier {tier}"
    for what, by_key in (("robot", keys.robot_of(key)), ("edge", keys.edge_of(key))):
        by_message = getattr(message, what, None)
        if by_key is not None and by_message is not None and by_message != by_key:
            return f"{type(message).__name__} speaks of {what} {by_message!r}, its key of {by_key!r}"
    return None


def sender_of(key: str) -> str:
    """`robot/r1`, `edge/e1`, `cloud`, `scheduler`; a foreign key stands for itself."""
    try:
        return "/".join(part for part in keys.owner(key) if part)
    except UsageError:
        return key[:64]


class Intake:
    """Decodes, checks, counts."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.counters = Counters()
        self.problems: deque[str] = deque(maxlen=PROBLEMS)
        self._clock = clock
        self._logged: dict[str, float] = {}

    def accept(self, key: str, payload: Payload, sent_s: float = 0.0) -> Received | None:
        """The message, or None when it is refused."""
        size = len(payload)
        self.counters.received += 1
        self.counters.received_bytes += size
        sender = sender_of(key)
        try:
            if size > MAX_MESSAGE_BYTES:  # before it is copied
                raise BadMessage(f"{size} bytes are over the limit of {MAX_MESSAGE_BYTES}", sender)
            message = decode(payload.to_bytes(), sender)
            fault = contradiction(key, message)
            if fault is not None:
                raise BadMessage(fault, sender)
        except BadMessage as error:
            self.refuse(sender, f"{error} (on {key})")
            return None
        return Received(key, message, size, sent_s)

    def refuse(self, sender: str, problem: str) -> None:
        """Count a refusal against its sender and keep its text."""
        if sender not in self.counters.refused and len(self.counters.refused) >= MAX_SENDERS:
            sender = "others"
        self.counters.refused[sender] += 1
        self.problems.append(problem[:500])
        now = self._clock()
        if now - self._logged.get(sender, float("-inf")) >= QUIET_S:
            self._logged[sender] = now
            log.warning("refused: %s", problem[:500])
