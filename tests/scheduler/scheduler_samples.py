"""A scheduler with some edges, and what robots do to it."""

from __future__ import annotations

from common.presence import RobotSeen
from common.wire import RobotProfile, Routes
from services.scheduler.events import EdgeSeen, Event, Instruction, Profiled, Publish, Tick
from services.scheduler.state import SchedulerState
from services.scheduler.topology import Topology

GRACE = 3.0


def scheduler(*edges: str, topology: str = "recslam") -> SchedulerState:
    """With these edges up since time 0."""
    state = SchedulerState(Topology(topology), edges, GRACE)
    for edge in edges:
        state.handle(EdgeSeen(edge, True, 0.0))
    return state


def profile(robot: str, *edges: str) -> RobotProfile:
    return RobotProfile(robot=robot, stream="a" * 32, edges=edges or None)


def tell(state: SchedulerState, *events: Event, now: float) -> list[Instruction]:
    """What comes of these events and of the tick after them."""
    return [step for event in (*events, Tick(now)) for step in state.handle(event)]


def come(state: SchedulerState, robot: str, *edges: str, now: float = 1.0) -> list[Instruction]:
    return tell(state, Profiled(profile(robot, *edges), now), RobotSeen(robot, True, now), now=now)


def table(steps: list[Instruction]) -> Routes:
    (step,) = [step for step in steps if isinstance(step, Publish)]
    return step.routes
