"""A random walk: a robot drives to one far and little visited place after the other, never near a wall.

The walk is planned leg by leg from a seed, so a longer walk begins with the shorter one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.sim.free import FreeSpace
from common.sim.world import Point, World

CLEARANCE = 0.3
"""m from the robot's centre to walls"""
REACH = 25.0
"""m of driving that one leg may take"""
CANDIDATES = 6


def wander(world: World, start: Point, length: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Waypoints (n, 2) in metres of a walk of at least `length` metres through the free space around `start`.

    The walk starts at a random place that can be reached from `start`. Raises ConfigError when there is no room.
    """
    space = FreeSpace.of(world, CLEARANCE)
    reached, _ = space.ways(start, np.inf)
    if len(reached) < 10:
        raise ConfigError(f"no room for a random walk around {start}: start it {CLEARANCE} m or more off the walls")
    way = [space.centres(reached[rng.integers(len(reached), size=1)])[0]]
    goals, driven = [way[0]], 0.0
    while driven < length:
        leg = _leg(space, way[-1], np.array(goals), rng)
        driven += float(np.hypot(*np.diff(leg, axis=0).T).sum())
        way.extend(leg[1:])
        goals.append(leg[-1])
    return np.array(way)


def _leg(
    space: FreeSpace, here: NDArray[np.float64], goals: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Way (n, 2) to that of a few random places in reach which lies farthest from all recent goals."""
    reached, parents = space.ways((float(here[0]), float(here[1])), REACH)
    choice = reached[rng.integers(1, len(reached), size=CANDIDATES)]
    spots = space.centres(choice)
    far = np.hypot(*(spots[:, None] - goals[-20:]).transpose(2, 0, 1)).min(axis=1)
    cells = [int(choice[far.argmax()])]
    while parents[cells[-1]] >= 0:
        cells.append(int(parents[cells[-1]]))
    return _straightened(space, space.centres(np.array(cells[::-1])))


def _straightened(space: FreeSpace, way: NDArray[np.float64]) -> NDArray[np.float64]:
    """The way with every waypoint left out that straight driving can do without."""
    kept, here = [way[0]], 0
    while here < len(way) - 1:
        ahead = here + 1
        while ahead + 1 < len(way) and space.open_line(way[here], way[ahead + 1]):
            ahead += 1
        kept.append(way[ahead])
        here = ahead
    return np.array(kept)
