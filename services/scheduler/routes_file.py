"""Planned routes from a file, and the overlaps that they promise before any map exists.

TOML or JSON, coordinates in metres in one frame; `reach` is how far a robot's sensor sees, given once or for each:

    reach = 8.0
    [robots]
    r1 = [[0, 0], [10, 0], [10, 5]]
    r2 = { way = [[2, 1], [9, 1]], reach = 3.5 }

A route of one waypoint is a start pose.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from common.errors import BadFile
from common.wire.base import Name
from common.wire.codec import explain
from services.scheduler.overlap import Footprint, Overlap, cells_of_route, lattice_cells, overlap_matrix

Metres = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]


class PlannedRoute(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    way: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=1)]
    reach: Metres | None = None


class RoutesFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    reach: Metres = 8.0
    robots: dict[Name, PlannedRoute]

    @field_validator("robots", mode="before")
    @classmethod
    def bare_ways(cls, value: Any) -> Any:
        """A bare list of waypoints is a route with the common reach."""
        if not isinstance(value, dict):
            return value
        return {name: {"way": route} if isinstance(route, list) else route for name, route in value.items()}


@dataclass(frozen=True)
class PlannedCoverage:
    """What the routes will see: overlaps, and the cells of each robot as `Problem.footprints` takes them."""

    overlap: Overlap
    cells: tuple[Any, ...]


def read_routes(path: Path) -> RoutesFile:
    """Raises BadFile naming the file and what is wrong."""
    try:
        text = path.read_text()
        data = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
        return RoutesFile.model_validate(data)
    except ValidationError as error:
        raise BadFile(f"{path}: {explain(error)}") from error
    except (OSError, ValueError) as error:
        raise BadFile(f"{path}: {error}") from error


def coverage(routes: RoutesFile) -> PlannedCoverage:
    """A sensor disc swept along each route."""
    footprints = [
        Footprint(robot, "planned", cells_of_route(route.way, route.reach or routes.reach), "route")
        for robot, route in sorted(routes.robots.items())
    ]
    return PlannedCoverage(overlap_matrix(footprints), lattice_cells(footprints))
