"""Joint correction as the cloud sees to it: trajectories of robots whose maps merged go into its merging process."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import numpy as np

from common.bus import Bus
from common.bus.trajectory import Trajectory, fetch_trajectory
from common.errors import PeerError, QueryFailed
from common.wire import Transforms, decode
from common.workers import WorkerError

TRIES = 5
RETRY_S = 1.0
"""a router that is lost for a moment must not cost the final map its correction"""

log = logging.getLogger(__name__)


async def corrected(
    solved: dict[str, Any],
    edges: Mapping[str, str],
    bus: Bus,
    call: Callable[..., Awaitable[Any]],
    problem: Callable[[str], None],
) -> dict[str, Any]:
    """What solving the final world gave, with bent maps straightened; as it was, and told so, where that fails.

    `solved` is what MergeHost.solve returned, `call` calls the merging process, `edges` run the robots.
    """
    try:
        tracks = await _tracks(solved, edges, bus)
        done = await call("correct", transforms=solved["transforms"], pairs=solved["merged"], tracks=tracks)
    except (PeerError, WorkerError) as error:
        problem(f"joint correction: rigid transforms stay: {error}")
        return solved
    log.info("joint correction", extra={"seconds": done["seconds"], "bytes": sum(map(len, tracks.values()))})
    return {**solved, "transforms": done["transforms"], "seconds": solved["seconds"] + done["seconds"]}


async def _tracks(solved: Mapping[str, Any], edges: Mapping[str, str], bus: Bus) -> dict[str, bytes]:
    """Rows of four float64 of each robot; they must belong to the very maps that the world was solved from.

    Otherwise the final map would depend on when it was made. Raises QueryFailed when one is not to be had so.
    """
    world = decode(solved["transforms"])
    assert isinstance(world, Transforms)
    tracks = {}
    for robot in sorted({robot for pair in solved["merged"] for robot in pair}):
        if robot not in edges:
            raise QueryFailed("it has left meanwhile", f"robot/{robot}")
        found = await _track(bus, edges[robot], robot)
        if found.version != world.robots[robot].version:
            raise QueryFailed("its map has changed meanwhile", f"robot/{robot}")
        tracks[robot] = np.ascontiguousarray(found.poses, np.float64).tobytes()
    return tracks


async def _track(bus: Bus, edge: str, robot: str) -> Trajectory:
    for _ in range(TRIES - 1):
        try:
            return await fetch_trajectory(bus, edge, robot)
        except QueryFailed as error:
            log.info("asking again for a trajectory", extra={"robot": robot, "edge": edge, "reason": error})
            await asyncio.sleep(RETRY_S)
    return await fetch_trajectory(bus, edge, robot)
