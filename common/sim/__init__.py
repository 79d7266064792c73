"""Simulated robots with ground truth: worlds, lasers, odometry and routes.

Importing this needs numpy alone; numba comes in with the first ray, OpenCV with maps from pictures and drawing.
"""

from common.sim.robot import SimulatedRobot
from common.sim.scene import Scene, load_scene

__all__ = ["Scene", "SimulatedRobot", "load_scene"]
