"""Routes told as the names of places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from common.sim.world import Point


def routes_of(places: Mapping[str, Point], told: Mapping[str, str]) -> dict[str, NDArray[np.float64]]:
    """Waypoints (n, 2) by route name; each route is told as place names between spaces."""
    return {route: np.array([places[name] for name in names.split()]) for route, names in told.items()}
