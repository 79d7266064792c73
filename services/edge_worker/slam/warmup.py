"""Compile every kernel once, so that workers load them from the cache."""

from __future__ import annotations

import numpy as np

from common.wire import Frame, LaserScan
from services.edge_worker.slam.kernel import create

BEAMS = 90
ROOM_M = (6.0, 5.0)
LAPS = 2
FRAMES_A_LAP = 60
FEW_PARTICLES = 3


def warmup() -> None:
    """Run both kernels over a robot's laps in a room: matching, loops, correction, drawing, snapshot and restore."""
    frames = list(laps())
    for name, settings in (
        ("graph", {"local_keyframes": 5, "submap_keyframes": 3, "clear_m": 2.0}),
        ("gmapping", {"particles": FEW_PARTICLES}),
    ):
        kernel = create(name, settings)
        for frame in frames:
            kernel.process(frame)
        kernel.finish()
        kernel.map()
        create(name, settings).restore(kernel.snapshot())


def laps() -> list[Frame]:
    """A robot that goes round in an empty room, its odometry true but for some drift in heading."""
    frames = []
    for k in range(LAPS * FRAMES_A_LAP):
        turn = 2 * np.pi * k / FRAMES_A_LAP
        pose = np.array([1.2 * np.sin(turn), 1.2 - 1.2 * np.cos(turn), turn])
        ranges = _walls(pose)
        ranges[0] = np.inf
        drifted = (k * 0.1, pose[0], pose[1], turn * 1.01)
        scan = LaserScan(
            angle_min=-np.pi,
            angle_increment=2 * np.pi / BEAMS,
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
                stamp=k * 0.1,
                scan=scan,
                odometry=np.array([drifted]),
                imu=np.array([(k * 0.1, 2 * np.pi / (FRAMES_A_LAP * 0.1), 0.0, 0.0)]),
            )
        )
    return frames


def _walls(pose: np.ndarray) -> np.ndarray:
    """Distances (BEAMS,) from `pose` to the walls of a room around (0, 1.2), with a box in it to tell ends apart."""
    angles = pose[2] - np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
    c, s = np.cos(angles), np.sin(angles)
    half_x, half_y = ROOM_M[0] / 2, ROOM_M[1] / 2
    x, y = pose[0], pose[1] - 1.2
    with np.errstate(divide="ignore"):
        across = np.where(c > 0, (half_x - x) / c, (-half_x - x) / c)
        along = np.where(s > 0, (half_y - y) / s, (-half_y - y) / s)
    ranges = np.minimum(np.where(np.isfinite(across), across, np.inf), np.where(np.isfinite(along), along, np.inf))
    corner = (c > 0.9) & (s > 0)
    return np.where(corner, ranges * 0.8, ranges)
