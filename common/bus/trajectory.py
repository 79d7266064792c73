"""A robot's trajectory over the bus."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.bus import keys
from common.bus.bus import Bus
from common.errors import QueryFailed
from common.wire import TrajectoryPage


class Trajectory(NamedTuple):
    """A robot's way in its own map frame."""

    version: int
    """of the robot map that it belongs to"""
    poses: NDArray[np.float64]
    """(n, 4): stamp s, x m, y m, theta rad"""


async def fetch_trajectory(bus: Bus, edge: str, robot: str) -> Trajectory:
    """The trajectory as the edge that runs the robot has it. Raises QueryFailed when it does not give it.

    Raises it also when the map changes between two pages: the rows would be of two trajectories.
    """
    parts, versions = [np.empty((0, 4))], set()
    key = keys.edge_trajectory(edge, robot)
    async for page in bus.pages(key):
        if not isinstance(page, TrajectoryPage):
            raise QueryFailed(f"answered with a {type(page).__name__}, not with a trajectory", edge)
        parts.append(page.poses)
        versions.add(page.version)
    if len(versions) != 1:
        raise QueryFailed("the map changed while its trajectory was being fetched; fetch again", key)
    return Trajectory(versions.pop(), np.concatenate(parts))
