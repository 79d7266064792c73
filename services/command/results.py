"""A global map as files: for Nav2, for people, for `evo`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.formats.map_server import write_map
from common.formats.picture import write_png
from common.formats.tum import write_trajectory
from services.command.collect import GlobalMap

PICTURE_SCALE = 3
"""pixels a cell"""
MARGIN = 10
"""cells of unknown around what is known"""
MAX_PIXELS = 6000
"""of a picture's longer side"""


def write_results(result: GlobalMap, folder: Path, name: str = "global_map") -> list[str]:
    """Write map (`name`.yaml, .pgm and .png), `transforms.json`, and `robots/<robot>.tum` in the world frame.

    Returns the names of the map's files: none when nothing is known, and those of an earlier map are taken away then.
    """
    files = [f"{name}.{kind}" for kind in ("png", "yaml", "pgm")]
    resolution = result.grid.resolution
    occupancy, (x, y) = cropped(*result.grid.occupancy())
    if occupancy.size:
        origin = (x * resolution, y * resolution, 0.0)
        scale = max(1, min(PICTURE_SCALE, MAX_PIXELS // max(occupancy.shape)))
        write_map(folder / name, occupancy, resolution, origin)
        write_png(folder / f"{name}.png", occupancy, resolution, origin, result.trajectories, scale)
    else:
        for file in files:
            (folder / file).unlink(missing_ok=True)
    (folder / "robots").mkdir(parents=True, exist_ok=True)
    for robot, trajectory in result.trajectories.items():
        write_trajectory(folder / "robots" / f"{robot}.tum", trajectory)
    (folder / "transforms.json").write_text(json.dumps(transforms(result), indent=2) + "\n")
    return files if occupancy.size else []


def cropped(occupancy: NDArray[np.int8], origin: tuple[int, int]) -> tuple[NDArray[np.int8], tuple[int, int]]:
    """What is known of a map (height, width) with a margin around it, and the cell (x, y) of its [0, 0]."""
    known = occupancy >= 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return occupancy[:0, :0], origin
    top, left = max(rows[0] - MARGIN, 0), max(columns[0] - MARGIN, 0)
    inside = occupancy[top : rows[-1] + MARGIN + 1, left : columns[-1] + MARGIN + 1]
    return inside, (origin[0] + int(left), origin[1] + int(top))


def transforms(result: GlobalMap) -> dict[str, object]:
    """Where each robot's map lies in the world, as plain data: metres and radians."""
    notice = result.notice
    return {
        "world_epoch": result.transforms.world_epoch,
        "final": result.transforms.final,
        "resolution_m": result.grid.resolution,
        "map": {"version": notice.version, "digest": notice.digest},
        "components": [list(component.robots) for component in notice.components],
        "robots": {
            robot: {"x_m": x, "y_m": y, "theta_rad": theta, "component": placed.component}
            for robot, placed in sorted(result.transforms.robots.items())
            for x, y, theta in [placed.transform.pose()]
        },
    }
