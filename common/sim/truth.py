"""What a perfect mapper could know: wall faces that some robot could see, and the area that was seen free.

Every sample of a face, and every cell's centre, is looked at by a ray of its own from each robot's true poses
until it is seen once. So what is found does not depend on the laser's beams, only on its reach and field of view.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.geometry import compose, wrap
from common.sim.world import Segments, World

if TYPE_CHECKING:
    from common.sim.robot import SimulatedRobot
    from common.sim.scene import Scene

STEP_M, STEP_RAD = 0.2, 0.5
"""how far a robot drives or turns between the poses that are looked from"""
TOLERANCE = 1e-4
"""m, by which a ray may stop short of what it looks at"""


def visible_walls(scene: Scene, robots: Iterable[SimulatedRobot], resolution: float) -> NDArray[np.float64]:
    """Points (n, 2) in metres on the wall faces that some robot could see, `resolution / 2` apart or less.

    Within the reach and the field of view of the robots' lasers; other robots do not hide walls.
    """
    return _seen(scene.world, robots, face_samples(scene.world.segments, resolution / 2))


def visible_area(scene: Scene, robots: Iterable[SimulatedRobot], resolution: float) -> NDArray[np.float64]:
    """Centres (n, 2) in metres of the cells [i r, (i+1) r) x [j r, (j+1) r) that some robot could see into."""
    x0, y0, x1, y1 = scene.world.bounds
    columns = np.arange(np.floor(x0 / resolution), np.ceil(x1 / resolution), dtype=np.float64)
    rows = np.arange(np.floor(y0 / resolution), np.ceil(y1 / resolution), dtype=np.float64)
    centres = (np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2) + 0.5) * resolution
    return _seen(scene.world, robots, centres)


def face_samples(segments: Segments, pitch: float) -> NDArray[np.float64]:
    """Points (n, 2) evenly along all segments, at most `pitch` metres apart and never on a segment's end."""
    along = segments[:, 2:] - segments[:, :2]
    counts = np.maximum(np.ceil(np.hypot(*along.T) / pitch).astype(int), 1)
    number = np.repeat(np.arange(len(segments)), counts)
    place = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
    return segments[number, :2] + ((place + 0.5) / counts[number])[:, None] * along[number]


def look_poses(robot: SimulatedRobot) -> NDArray[np.float64]:
    """True laser poses (n, 3) in the world, one each time that the robot has driven or turned some way."""
    poses = robot.track.turned(np.arange(0.0, robot.duration, 0.05))
    step = np.abs(np.diff(poses, axis=0))
    effort = np.cumsum(np.hypot(step[:, 0], step[:, 1]) / STEP_M + step[:, 2] / STEP_RAD)
    chosen = np.concatenate([[True], np.diff(np.floor(effort), prepend=0.0) > 0])
    return compose(poses[chosen], robot.lidar.geometry.mount)


def _seen(world: World, robots: Iterable[SimulatedRobot], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Those of the points (n, 2) to which a ray from some pose gets."""
    unseen, found = points, []
    for robot in robots:
        geometry = robot.lidar.geometry
        half = abs(geometry.angle_increment) * robot.lidar.beams / 2
        middle = geometry.angle_min + geometry.angle_increment * (robot.lidar.beams - 1) / 2
        for pose in look_poses(robot):
            offset = unseen - pose[:2]
            distance = np.hypot(offset[:, 0], offset[:, 1])
            bearing = np.arctan2(offset[:, 1], offset[:, 0])
            near = (distance < geometry.range_max) & (np.abs(wrap(bearing - pose[2] - middle)) <= half)
            numbers = np.flatnonzero(near)
            origins = np.broadcast_to(pose[:2], (len(numbers), 2))
            reached = world.index.cast(origins, bearing[numbers], geometry.range_max)
            hit = numbers[reached >= distance[numbers] - TOLERANCE]
            found.append(unseen[hit])
            unseen = np.delete(unseen, hit, axis=0)
    return np.vstack(found) if found else np.empty((0, 2))
