"""A furnished room, a robot that drives round in it, and the `gmapping` kernel that maps it."""

from __future__ import annotations

import numpy as np

from common.geometry import between, compose
from common.wire import Frame, LaserScan
from services.edge_worker.slam.gmapping.gmapping import GMapping

FEW = {"particles": 6}
BEAMS = 180
WALLS = np.array(
    [
        [[-3, -2], [4, -2]],
        [[4, -2], [4, 3]],
        [[4, 3], [-3, 3]],
        [[-3, 3], [-3, -2]],
        [[1, -2], [1, -0.6]],
        [[-1, 3], [-1, 1.4]],
        [[2.5, 3], [2.5, 2]],
        [[-3, 0], [-2.2, 0.4]],
    ],
    float,
)


def ranges_at(pose: np.ndarray, beams: int = BEAMS) -> np.ndarray:
    """Ranges (beams,) all around in a furnished room of 7 x 5 m."""
    angles = pose[2] - np.pi + 2 * np.pi / beams * np.arange(beams)
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]
    start, along = WALLS[:, 0] - pose[:2], WALLS[:, 1] - WALLS[:, 0]
    cross = ray[..., 0] * along[:, 1] - ray[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * ray[..., 1] - start[:, 1] * ray[..., 0]) / cross
    return np.where((way > 0) & (share >= 0) & (share <= 1), way, np.inf).min(axis=1)


def route(frames: int) -> np.ndarray:
    """(frames, 3): round the room along an ellipse, looking ahead, from the origin."""
    turn = np.linspace(0, 4 * np.pi * frames / 240, frames)
    x, y = 1.3 * np.sin(turn), 0.6 - 0.6 * np.cos(turn)
    return np.stack([x, y, np.unwrap(np.arctan2(0.6 * np.sin(turn), 1.3 * np.cos(turn)))], axis=1)


def drive(frames: int = 120, odometry: bool = True, imu: bool = False, seed: int = 0) -> list[Frame]:
    """A robot with a noisy laser whose odometry drifts (2 % in length, 5 % in turns), at 5 Hz."""
    rng, truth = np.random.default_rng(seed), route(frames)
    reckoned = np.zeros(3)
    out = []
    for k, pose in enumerate(truth):
        moved = between(truth[k - 1], pose) if k else np.zeros(3)
        reckoned = compose(reckoned, moved * [1.02, 1.02, 1.05])
        ranges = ranges_at(pose) + rng.normal(0, 0.01, BEAMS)
        gyro = np.array([[k / 5 + t, moved[2] * 5 + 0.02, 0, 0] for t in (-0.15, -0.1, -0.05, 0.0)])
        scan = LaserScan(
            angle_min=-np.pi,
            angle_increment=2 * np.pi / BEAMS,
            range_min=0.1,
            range_max=12.0,
            quantum=0,
            ranges=ranges.astype(np.float32),
        )
        out.append(
            Frame(
                robot="r",
                stream="0" * 32,
                seq=k,
                stamp=k / 5,
                scan=scan,
                odometry=np.array([[k / 5, *reckoned]]) if odometry else None,
                imu=gyro if imu else None,
            )
        )
    return out


def changed(frame: Frame, **scan: object) -> Frame:
    assert frame.scan is not None
    return frame.model_copy(update={"scan": frame.scan.model_copy(update=scan)})


def run(frames: list[Frame], seed: int = 1, **settings: object) -> GMapping:
    kernel = GMapping.create({**FEW, **settings}, seed)
    for frame in frames:
        kernel.process(frame)
    kernel.finish()
    return kernel


def errors(kernel: GMapping, frames: int) -> tuple[float, float]:
    """Greatest error in metres and in radians, from the first pose on."""
    rows = kernel.trajectory()
    assert len(rows) == frames
    off = between(compose(route(frames)[0], rows[:, 1:]), route(frames))
    return float(np.hypot(off[:, 0], off[:, 1]).max()), float(np.abs(off[:, 2]).max())
