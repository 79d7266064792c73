"""Compile every kernel once, so that workers load them from the cache."""

from __future__ import annotations

from typing import Any

import numpy as np

from common.grid.standing import stands
from common.wire import Frame, LaserScan
from services.edge_worker.slam.corrections import median_step
from services.edge_worker.slam.registry import create

BEAMS = (90, 360)
"""of each lap: scans with few points are compiled code of their own, where those with many are thinned"""
ROOM_M = (6.0, 5.0)
FRAMES_A_LAP = 20
LAP_S = 6.0
FEW_PARTICLES = 3
SETTINGS: dict[str, dict[str, Any]] = {
    "graph": {"local_keyframes": 5, "submap_keyframes": 3, "clear_m": 2.0},
    "gmapping": {"particles": FEW_PARTICLES},
}
"""with which few frames come by all that is compiled"""


def warmup(*names: str) -> None:
    """Run both kernels, or those named, over a robot's laps in a room.

    That is matching, loops, correction, drawing, snapshot and restore. A kernel that is plugged in warms itself.
    """
    frames = laps()
    for name, settings in SETTINGS.items():
        if names and name not in names:
            continue
        kernel = create(name, settings)
        for frame in frames:
            kernel.process(frame)
        kernel.finish()
        kernel.map()
        stands(kernel.trajectory())
        create(name, settings).restore(kernel.snapshot())
    # Which particle is best changes too seldom for the laps to show a map that moved.
    median_step(np.zeros((1, 2), np.float32), np.zeros(3), np.zeros(3))


def laps() -> list[Frame]:
    """A robot that goes round in an empty room, its odometry true but for some drift in heading."""
    frames = []
    step_s = LAP_S / FRAMES_A_LAP
    for k in range(len(BEAMS) * FRAMES_A_LAP):
        beams = BEAMS[k // FRAMES_A_LAP]
        turn = 2 * np.pi * k / FRAMES_A_LAP
        pose = np.array([1.2 * np.sin(turn), 1.2 - 1.2 * np.cos(turn), turn])
        ranges = _walls(pose, beams)
        ranges[0] = np.inf
        drifted = (k * step_s, pose[0], pose[1], turn * 1.01)
        scan = LaserScan(
            angle_min=-np.pi,
            angle_increment=2 * np.pi / beams,
            range_min=0.1,
            range_max=12.0,
            time_increment=1e-4,
            quantum=0.001,
            ranges=LaserScan.quantise(ranges, 0.001),
        )
        frames.append(
            Frame(
                robot="warmup",
                stream="0" * 32,
                seq=k,
                stamp=k * step_s,
                scan=scan,
                odometry=np.array([drifted]),
                imu=np.array([(k * step_s, 2 * np.pi / LAP_S, 0.0, 0.0)]),
            )
        )
    return frames


def _walls(pose: np.ndarray, beams: int) -> np.ndarray:
    """Distances (beams,) from `pose` to the walls of a room around (0, 1.2), with a box in it to tell ends apart."""
    angles = pose[2] - np.pi + 2 * np.pi / beams * np.arange(beams)
    c, s = np.cos(angles), np.sin(angles)
    half_x, half_y = ROOM_M[0] / 2, ROOM_M[1] / 2
    x, y = pose[0], pose[1] - 1.2
    with np.errstate(divide="ignore"):
        across = np.where(c > 0, (half_x - x) / c, (-half_x - x) / c)
        along = np.where(s > 0, (half_y - y) / s, (-half_y - y) / s)
    ranges = np.minimum(np.where(np.isfinite(across), across, np.inf), np.where(np.isfinite(along), along, np.inf))
    corner = (c > 0.9) & (s > 0)
    return np.where(corner, ranges * 0.8, ranges)
