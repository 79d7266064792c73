"""What reaches the scheduler's state machine, and what it asks its shell to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from common.presence import Linked, RobotSeen
from common.wire import Claims, Epoch, RobotProfile, Routes


@dataclass(frozen=True)
class EdgeSeen:
    edge: str
    alive: bool
    now: float


@dataclass(frozen=True)
class Profiled:
    profile: RobotProfile
    now: float


@dataclass(frozen=True)
class Claimed:
    """What edges say that they run, at the start of this scheduler or at any time."""

    claims: tuple[Claims, ...]
    now: float


@dataclass(frozen=True)
class Planned:
    """A plan is ready, made for the table of `epoch`."""

    epoch: Epoch
    slam: Mapping[str, str]
    fuse: Mapping[str, str]
    now: float


@dataclass(frozen=True)
class Relieved:
    """An edge cannot keep up: these robots shall be run elsewhere, whatever has been planned."""

    edge: str
    moves: Mapping[str, str]
    """robot → edge"""
    reason: str
    now: float


@dataclass(frozen=True)
class PlanFailed:
    """The planner could not make one."""


@dataclass(frozen=True)
class Tick:
    """Five times a second."""

    now: float


@dataclass(frozen=True)
class Interval:
    """Every `interval_s`."""

    now: float


Event = RobotSeen | EdgeSeen | Profiled | Linked | Claimed | Planned | Relieved | PlanFailed | Tick | Interval


@dataclass(frozen=True)
class Publish:
    routes: Routes
    reason: str


@dataclass(frozen=True)
class MakePlan:
    """Plan these robots over these edges, given the table of `epoch`."""

    epoch: Epoch
    robots: tuple[str, ...]
    edges: tuple[str, ...]


Instruction = Publish | MakePlan
