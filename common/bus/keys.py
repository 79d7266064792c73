"""Key expressions of the system, relative to the bus's root; `"*"` for a name gives the wildcard form.

One prefix per owner (`robot/<rid>`, `edge/<eid>`, `cloud`, `scheduler`), so that access control stays simple: who owns
a key is the only one who publishes on it, and the sender of a message is told by its key.
"""

from __future__ import annotations

import re

from common.errors import UsageError
from common.wire.limits import NAME_PATTERN

ANY = "*"
"""in place of a name: all of them"""

CLOUD_MAP = "cloud/map"
CLOUD_TRANSFORMS = "cloud/transforms"
CLOUD_VERDICTS = "cloud/verdicts"
CLOUD_STATUS = "cloud/status"
CLOUD_ALIVE = "cloud/alive"
SCHEDULER_ROUTES = "scheduler/routes"
SCHEDULER_OVERLAP = "scheduler/overlap"
SCHEDULER_PLAN = "scheduler/plan"
SCHEDULER_STATUS = "scheduler/status"
SCHEDULER_ALIVE = "scheduler/alive"

_NAME = re.compile(NAME_PATTERN)


def _named(name: str) -> str:
    if name != ANY and not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name: use 1 to 64 of A-Z a-z 0-9 _ - (or * for all)")
    return name


def _robot(robot: str, leaf: str) -> str:
    return f"robot/{_named(robot)}/{leaf}"


def _edge(edge: str, leaf: str) -> str:
    return f"edge/{_named(edge)}/{leaf}"


def robot_frames(robot: str) -> str:
    """Stream of Frame."""
    return _robot(robot, "frames")


def robot_end(robot: str) -> str:
    """Latched EndOfStream."""
    return _robot(robot, "end")


def robot_backfill(robot: str) -> str:
    """Queryable `?stream=&from=&to=`: pages of frames out of the spool."""
    return _robot(robot, "backfill")


def robot_profile(robot: str) -> str:
    """Latched RobotProfile."""
    return _robot(robot, "profile")


def robot_status(robot: str) -> str:
    """Latched RobotStatus."""
    return _robot(robot, "status")


def robot_alive(robot: str) -> str:
    """Liveliness token."""
    return _robot(robot, "alive")


def edge_pose(edge: str, robot: str) -> str:
    """Stream of PoseUpdate."""
    return _edge(edge, _robot(robot, "pose"))


def edge_ack(edge: str, robot: str) -> str:
    """Latched Ack."""
    return _edge(edge, _robot(robot, "ack"))


def edge_robot_map(edge: str, robot: str) -> str:
    """Latched MapNotice, and a queryable of its tiles: `kind=counts`, or `kind=occupancy`, the sketch."""
    return _edge(edge, _robot(robot, "map"))


def edge_trajectory(edge: str, robot: str) -> str:
    """Queryable: pages of the corrected trajectory."""
    return _edge(edge, _robot(robot, "trajectory"))


def edge_map(edge: str) -> str:
    """Latched EdgeMapNotice, and a queryable of its tiles."""
    return _edge(edge, "map")


def edge_status(edge: str) -> str:
    """Latched EdgeStatus."""
    return _edge(edge, "status")


def edge_claims(edge: str) -> str:
    """Latched Claims."""
    return _edge(edge, "claims")


def edge_verdicts(edge: str) -> str:
    """Latched Verdicts."""
    return _edge(edge, "verdicts")


def edge_alive(edge: str) -> str:
    """Liveliness token."""
    return _edge(edge, "alive")


def owner(key: str) -> tuple[str, str]:
    """(tier, id) of the key's owner; the id is empty for cloud and scheduler. Raises UsageError on a foreign key."""
    match key.split("/"):
        case ["robot" | "edge" as tier, name, _, *_]:
            return tier, name
        case ["cloud" | "scheduler" as tier, _, *_]:
            return tier, ""
    raise UsageError(f"{key!r} is no key of this system")


def robot_of(key: str) -> str | None:
    """The robot that the key is about, None when it is about none."""
    match key.split("/"):
        case ["robot", name, _, *_] | ["edge", _, "robot", name, _, *_] | ["cloud", "checkpoint", name]:
            return name
    return None


def edge_of(key: str) -> str | None:
    """The edge that owns the key, None when no edge does."""
    match key.split("/"):
        case ["edge", name, _, *_]:
            return name
    return None
