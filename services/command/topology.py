"""Topologies are routing, not code: which edges there are, who reaches which, and what runs beside what."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common.config import EdgeEntry, Fleet, RobotEntry
from common.errors import ConfigError
from services.command.fleets import revised


@dataclass(frozen=True)
class Program:
    """One service of a cluster as a process."""

    name: str
    """`scheduler`, `cloud`, `edge/edge-1`, `robot/r1`"""
    module: str
    arguments: tuple[str, ...] = ()
    delay_s: float = 0.0
    beside: str | None = None
    """name of the program whose process group it joins: they are one host"""

    def command(self, config: Path, endpoint: str) -> list[str]:
        shared = ["--config", str(config), "--endpoint", endpoint]
        return [sys.executable, "-m", f"services.{self.module}", *self.arguments, *shared]


def arrange(fleet: Fleet) -> Fleet:
    """The fleet with the edges that its topology wants.

    `recslam` and `edge-only` take those of the file, `single-edge` the first of them; `cloud` and `local` put an edge
    beside each robot, which reaches no other. Raises ConfigError when there is nothing to start, or a robot would wait
    for ever for an edge that nobody starts.
    """
    if not fleet.robots:
        raise ConfigError("robots: none; a fleet that is started here names its robots")
    if fleet.topology in ("cloud", "local"):
        return _edge_beside_each(fleet)
    if not fleet.edges:
        raise ConfigError(f"edges: none; topology {fleet.topology} needs at least one")
    if fleet.topology == "single-edge":
        only = fleet.edges[:1]
        robots = tuple(robot.model_copy(update={"edges": None}) for robot in fleet.robots)
        return revised(fleet, edges=only, robots=robots)
    for robot in fleet.robots:
        _check_reach(robot, fleet.edge_ids())
    return fleet


def programs(fleet: Fleet, spool: Path) -> Iterator[Program]:
    """What runs for an arranged fleet, in the order of starting."""
    first = f"edge/{fleet.edges[0].id}" if fleet.topology in ("edge-only", "local") else None
    yield Program("scheduler", "scheduler")
    for edge in fleet.edges:
        yield Program(f"edge/{edge.id}", "edge_worker", ("--id", edge.id))
    yield Program("cloud", "cloud_merger", beside=first)
    for robot in fleet.robots:
        arguments = ("--id", robot.id, "--spool", str(spool))
        yield Program(f"robot/{robot.id}", "robot_agent", arguments, robot.join_after_s)


def _check_reach(robot: RobotEntry, edges: tuple[str, ...]) -> None:
    known = ", ".join(edges)
    if robot.edges is not None and not robot.edges:
        raise ConfigError(f"robots: {robot.id}: edges: none within reach; leave it out for all, or name of {known}")
    strange = sorted(set(robot.edges or ()) - set(edges))
    if strange:
        raise ConfigError(f"robots: {robot.id}: edges: the fleet has no {', '.join(strange)}; there are {known}")


def _edge_beside_each(fleet: Fleet) -> Fleet:
    if fleet.topology == "local" and len(fleet.robots) > 1:
        names = ", ".join(robot.id for robot in fleet.robots)
        raise ConfigError(f"topology: local is one robot with its own edge, this fleet has {names}; take `cloud`")
    model = fleet.edges[0] if fleet.edges else EdgeEntry(id="edge")
    robots = tuple(robot.model_copy(update={"edges": (f"edge-{robot.id}",)}) for robot in fleet.robots)
    edges = tuple(model.model_copy(update={"id": f"edge-{robot.id}"}) for robot in fleet.robots)
    return revised(fleet, robots=robots, edges=edges)
