"""A simulated robot: sweeps with odometry and IMU samples, and the truth behind them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.sim.lidar import Disc, lidar_named, true_ranges
from common.sim.motion import Pace
from common.sim.odometry import OdometryNoise, imu, preset, wheel_odometry
from common.sim.scene import Scene, generator
from common.sweep import Sweep
from common.wire.base import PoseTuple

RADIUS = 0.15
"""m, of a robot as others see it"""


class SimulatedRobot:
    """One robot of a scene; the same arguments give the same sweeps, bit for bit."""

    def __init__(
        self,
        scene: Scene,
        robot: str,
        seed: int,
        *,
        lidar: str = "rplidar_a1",
        speed_mps: float = 0.5,
        turn_radps: float = 0.8,
        duration_s: float | None = None,
        route: str = "",
        imu: bool = True,
        wheels: bool = True,
        peers: Sequence[str] | Mapping[str, str] = (),
        noise: str | OdometryNoise = "good",
        mount: PoseTuple = (0.0, 0.0, 0.0),
    ) -> None:
        """`peers` are the other robots to be seen: names, or names with their routes ("" as for `route`).

        Peers drive at this robot's pace. Raises ConfigError for unknown routes, lasers and noise presets.
        """
        pace = Pace(speed_mps, turn_radps)
        self.scene, self.robot, self.seed = scene, robot, seed
        self.lidar = lidar_named(lidar).mounted(mount)
        self.noise = preset(noise) if isinstance(noise, str) else noise
        self.track = scene.track(robot, seed, pace, route, duration_s)
        self.duration = self.track.duration if duration_s is None else duration_s
        """s of simulated time"""
        self._imu, self._wheels = imu, wheels
        routes = dict(peers) if isinstance(peers, Mapping) else dict.fromkeys(peers, "")
        self._discs = [
            Disc(scene.track(peer, seed, pace, peer_route, self.duration), RADIUS)
            for peer, peer_route in sorted(routes.items())
            if peer != robot
        ]

    def pose(self, stamp: float) -> NDArray[np.float64]:
        """True pose (3,) of the base in the world at a time: m, m, rad."""
        return self.poses([stamp])[0]

    def poses(self, stamps: ArrayLike) -> NDArray[np.float64]:
        """True poses (n, 3) of the base in the world at times (n,)."""
        return self.track.at(stamps)

    def stamps(self) -> NDArray[np.float64]:
        """When each sweep begins (n,), s; the last one ends within the duration."""
        sweep = self.lidar.beams * self.lidar.geometry.time_increment
        count = int(np.floor((self.duration - sweep) * self.lidar.rate_hz + 1e-9)) + 1
        return np.arange(max(count, 0)) / self.lidar.rate_hz

    def sweeps(self) -> Iterator[Sweep]:
        """All sweeps from the first; each comes with the samples taken up to the end of its last beam."""
        rng = generator(self.scene.name, self.seed, self.robot, "laser")
        odometry = wheel_odometry(self.track, self.duration, self.noise, self._generator("wheels"))
        inertial = imu(self.track, self.duration, self.noise, self._generator("imu"))
        sweep, taken = self.lidar.offsets()[-1], -np.inf
        for stamp in self.stamps().tolist():
            ranges = true_ranges(self.scene.world, self.lidar, self.track, stamp, self._discs)
            end = stamp + sweep
            yield Sweep(
                stamp,
                self.lidar.geometry,
                self.lidar.spoil(ranges, rng),
                _during(odometry, taken, end) if self._wheels else None,
                _during(inertial, taken, end) if self._imu else None,
            )
            taken = end

    def _generator(self, part: str) -> np.random.Generator:
        return generator(self.scene.name, self.seed, self.robot, part)


def _during(samples: NDArray[np.float64], after: float, until: float) -> NDArray[np.float64]:
    """The samples (k, 4) later than `after` and not later than `until`."""
    first, last = np.searchsorted(samples[:, 0], [after, until], side="right")
    return samples[first:last]
