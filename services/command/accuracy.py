"""How true a map is, where the truth is known: of simulated robots.

Starts are hidden from the system, so ONE rigid motion for all robots' trajectories brings the world frame to the
scene's; maps are never fitted. What counts as truth are the wall faces that some robot could see.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from common.config import Fleet, SimSource
from common.errors import UsageError
from common.evaluation.maps import score_occupancy, wall_thickness
from common.evaluation.trajectory import absolute_error, fit_all
from common.sim import SimulatedRobot, load_scene
from common.sim.truth import visible_area, visible_walls
from services.command.collect import GlobalMap

AREA_CELLS = 2
"""the free space is sampled every so many cells: finer tells no more"""


@dataclass(frozen=True)
class Accuracy:
    """All shares are 0..1."""

    iou: float
    precision: float
    recall: float
    coverage: float
    """share of the free space that some robot could see"""
    wall_thickness_cells: float
    ate_m: dict[str, float]
    """root mean square error of positions, of each robot and of `all`, after one common fit"""
    robots: int
    """robots that the fit rests on"""
    missing: tuple[str, ...]
    """robots of the fleet without a place in the world: what they saw counts as not found"""

    def plain(self) -> dict[str, object]:
        return asdict(self)


def score(result: GlobalMap, truth: Fleet) -> Accuracy | None:
    """`truth` is the fleet whose simulated robots were driven. None when it simulates none, or in several scenes."""
    robots = simulated(truth)
    placed = [name for name in sorted(robots) if len(result.trajectories.get(name, ()))]
    if not placed:
        return None
    estimates = [result.trajectories[name] for name in placed]
    truths = [_true_track(robots[name], track) for name, track in zip(placed, estimates, strict=True)]
    pose, moved, matched = fit_all(estimates, truths)
    scene, resolution = next(iter(robots.values())).scene, result.grid.resolution
    occupancy, (x, y) = result.grid.occupancy()
    found = score_occupancy(
        occupancy,
        resolution,
        visible_walls(scene, robots.values(), resolution),
        origin=(x * resolution, y * resolution, 0.0),
        pose=pose,
        truth_free=visible_area(scene, robots.values(), AREA_CELLS * resolution),
    )
    errors = {"all": absolute_error(moved, matched, align=False).rmse}
    errors |= {
        name: absolute_error([ours], [theirs], align=False).rmse
        for name, ours, theirs in zip(placed, moved, matched, strict=True)
    }
    return Accuracy(
        iou=found.iou,
        precision=found.precision,
        recall=found.recall,
        coverage=found.coverage,
        wall_thickness_cells=wall_thickness(occupancy),
        ate_m=errors,
        robots=len(placed),
        missing=tuple(sorted(set(robots) - set(placed))),
    )


def simulated(fleet: Fleet) -> dict[str, SimulatedRobot]:
    """The fleet's robots as they truly drove, by name; empty when not all are simulated in one scene."""
    sources = {entry.id: entry.source for entry in fleet.robots}
    scenes = {source.scene if isinstance(source, SimSource) else None for source in sources.values()}
    if len(scenes) != 1 or None in scenes:
        return {}
    scene = load_scene(str(scenes.pop()))
    return {
        name: SimulatedRobot(
            scene,
            name,
            fleet.seed,
            lidar=source.lidar,
            speed_mps=source.speed_mps,
            turn_radps=source.turn_radps,
            duration_s=source.duration_s,
            route=source.route,
        )
        for name, source in sources.items()
        if isinstance(source, SimSource)
    }


def _true_track(robot: SimulatedRobot, estimate: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4) at the stamps of the estimate."""
    stamps = estimate[:, 0]
    if stamps.min() < 0 or stamps.max() > robot.duration:
        raise UsageError(f"stamps of {robot.robot} are none of its simulation: was it recorded by another fleet?")
    return np.column_stack([stamps, robot.poses(stamps)])
