"""What a cluster has made, fetched from the keys that anybody may read."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from common.bus import Bus, keys
from common.bus.tiles import fetch_tiles
from common.bus.trajectory import fetch_trajectory
from common.errors import PeerError, QueryFailed
from common.geometry import compose
from common.grid import Grid
from common.grid.tiles import decode_counts
from common.grid.warp import straightened
from common.wire import (
    CloudStatus,
    EdgeStatus,
    GlobalMapNotice,
    Message,
    OverlapMatrix,
    PairVerdict,
    Plan,
    RobotStatus,
    Route,
    Routes,
    SchedulerStatus,
    Transforms,
    Verdicts,
)
from common.wire.edge import VANISHED

M = TypeVar("M", bound=Message)

PATIENCE_S = 5.0
RESTLESS_S = 15.0
"""s that a map may go on changing while it is fetched: when the world has moved, busy edges take a while to follow"""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Statuses:
    """The last words of everybody, by name."""

    robots: Mapping[str, RobotStatus] = field(default_factory=dict)
    edges: Mapping[str, EdgeStatus] = field(default_factory=dict)
    cloud: CloudStatus | None = None
    scheduler: SchedulerStatus | None = None
    routes: Routes | None = None
    plan: Plan | None = None
    overlap: OverlapMatrix | None = None
    verdicts: tuple[PairVerdict, ...] = ()
    """of all pairs of robots, by their names"""

    @property
    def vanished(self) -> dict[str, int]:
        return vanished(self.edges, self.routes.routes if self.routes is not None else {})


@dataclass(frozen=True)
class GlobalMap:
    """One version of the global map with all that belongs to it."""

    notice: GlobalMapNotice
    grid: Grid
    transforms: Transforms
    trajectories: Mapping[str, NDArray[np.float64]]
    """robot → (n, 4) stamp s, x m, y m, theta rad in the world; robots that lie nowhere are left out"""


async def global_map(bus: Bus) -> GlobalMap:
    """The newest global map, whole and with the world that it is drawn in. Raises QueryFailed when there is none."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + RESTLESS_S
    while True:
        notice = await one(bus, keys.CLOUD_MAP, GlobalMapNotice)
        transforms = await one(bus, keys.CLOUD_TRANSFORMS, Transforms)
        if notice is None or transforms is None:
            raise QueryFailed("there is no global map yet; see `recslam status`", keys.CLOUD_MAP)
        try:
            grid, told = await fetch_grid(bus), "the map went on changing"
        except PeerError as error:
            grid, told = Grid(notice.resolution), str(error)
        if grid.digest() == notice.digest and transforms.world_epoch == notice.world_epoch:
            return GlobalMap(notice, grid, transforms, await trajectories(bus, transforms))
        if loop.time() > deadline:
            raise QueryFailed(f"not to be had whole in {RESTLESS_S:g} s: {told}; try again", keys.CLOUD_MAP)
        await asyncio.sleep(0.2)


async def fetch_grid(bus: Bus) -> Grid:
    """All tiles of the global map."""
    delta = await fetch_tiles(bus, keys.CLOUD_MAP)
    grid = Grid(delta.resolution)
    grid.replace([((tile.x, tile.y), decode_counts(tile.data, keys.CLOUD_MAP)) for tile in delta.tiles])
    return grid


async def trajectories(bus: Bus, transforms: Transforms) -> dict[str, NDArray[np.float64]]:
    """Every placed robot's trajectory in the world; one that cannot be had is left out and logged."""
    routes = await one(bus, keys.SCHEDULER_ROUTES, Routes)
    found: dict[str, NDArray[np.float64]] = {}
    for robot, placed in sorted(transforms.robots.items()):
        route = routes.routes.get(robot) if routes is not None else None
        if route is None:
            log.warning("no route tells where the trajectory is", extra={"robot": robot})
            continue
        try:
            own = (await fetch_trajectory(bus, route.slam_edge, robot)).poses
        except PeerError as error:
            log.warning("trajectory not to be had", extra={"robot": robot, "reason": error})
            continue
        straight = straightened(placed.warp, own[:, 1:])
        found[robot] = np.column_stack([own[:, 0], compose(placed.transform.pose(), straight)])
    return found


async def statuses(bus: Bus) -> Statuses:
    """Whatever is latched now; who does not answer is left out."""
    robots = await several(bus, keys.robot_status(keys.ANY), RobotStatus)
    edges = await several(bus, keys.edge_status(keys.ANY), EdgeStatus)
    return Statuses(
        robots={status.robot: status for status in sorted(robots, key=lambda status: status.robot)},
        edges={status.edge: status for status in sorted(edges, key=lambda status: status.edge)},
        cloud=await one(bus, keys.CLOUD_STATUS, CloudStatus),
        scheduler=await one(bus, keys.SCHEDULER_STATUS, SchedulerStatus),
        routes=await one(bus, keys.SCHEDULER_ROUTES, Routes),
        plan=await one(bus, keys.SCHEDULER_PLAN, Plan),
        overlap=await one(bus, keys.SCHEDULER_OVERLAP, OverlapMatrix),
        verdicts=await _verdicts(bus),
    )


def vanished(edges: Mapping[str, EdgeStatus], routes: Mapping[str, Route]) -> dict[str, int]:
    """robot → last frame, of robots that are gone for good, as the edges that run them say."""
    return {
        each.robot: each.processed
        for name, status in sorted(edges.items())
        for each in status.instances
        if each.state == VANISHED and each.robot in routes and routes[each.robot].slam_edge == name
    }


async def _verdicts(bus: Bus) -> tuple[PairVerdict, ...]:
    """The cloud's word on a pair goes before an edge's."""
    edges = await several(bus, keys.edge_verdicts(keys.ANY), Verdicts)
    cloud = await several(bus, keys.CLOUD_VERDICTS, Verdicts)
    pairs = {(pair.a, pair.b): pair for said in [*edges, *cloud] for pair in said.pairs}
    return tuple(pairs[names] for names in sorted(pairs))


async def one(bus: Bus, key: str, kind: type[M]) -> M | None:
    """The latched value of a key; None when nobody answers."""
    found = await several(bus, key, kind)
    return found[0] if found else None


async def several(bus: Bus, key: str, kind: type[M]) -> list[M]:
    """The latched values of a wildcard key."""
    try:
        answers = await bus.get(key, timeout_s=PATIENCE_S, everyone=True)
    except PeerError as error:
        log.warning("no good answer", extra={"key": key, "reason": error})
        return []
    return [answer.message for answer in answers if isinstance(answer.message, kind)]
