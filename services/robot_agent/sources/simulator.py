"""A robot of a simulated scene. Only a robot that is simulated needs the simulator's own dependencies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from common.config import SimSource
from common.errors import UsageError
from common.sweep import Sweep
from services.robot_agent.sources.source import SourceProfile


class Simulator:
    """`peers` are the other robots of the scene, seen by this one's laser, with their routes.

    Raises ConfigError for unknown scenes and routes, UsageError when the simulator is not installed.
    """

    def __init__(self, entry: SimSource, robot: str, seed: int, peers: Mapping[str, str]) -> None:
        try:
            from common.sim.robot import SimulatedRobot
            from common.sim.scene import load_scene
        except ModuleNotFoundError as error:
            raise UsageError(f"the simulator needs {error.name}; install it: pip install 'recslam[edge]'") from error
        self._robot = SimulatedRobot(
            load_scene(entry.scene),
            robot,
            seed,
            lidar=entry.lidar,
            speed_mps=entry.speed_mps,
            turn_radps=entry.turn_radps,
            duration_s=entry.duration_s,
            route=entry.route,
            imu=entry.imu,
            wheels=entry.wheels,
            peers=peers,
            noise=entry.noise,
        )
        self.profile = SourceProfile(
            name=f"simulation of {entry.scene}",
            sensor=entry.lidar,
            range_max=self._robot.lidar.geometry.range_max,
            can_wait=True,
        )

    def sweeps(self) -> Iterator[Sweep]:
        return self._robot.sweeps()
