"""From a robot's entry in the fleet file to its source."""

from __future__ import annotations

import zlib

from common.config import CarmenSource, Fleet, RecordingSource, RobotEntry, SimSource
from services.robot_agent.sources.carmen import CarmenRobot
from services.robot_agent.sources.recording import Recording
from services.robot_agent.sources.simulator import Simulator
from services.robot_agent.sources.source import Source


def make(entry: RobotEntry, fleet: Fleet) -> Source:
    """The source that the entry names; opens what must be opened. Raises UsageError, ConfigError or BadFile."""
    match entry.source:
        case SimSource() as sim:
            return Simulator(sim, entry.id, fleet.seed, peers_of(entry.id, sim.scene, fleet))
        case CarmenSource() as carmen:
            # robots of one fleet must not start in the same hidden frame; generators take no negative seed
            return CarmenRobot(carmen, seed=(fleet.seed + zlib.crc32(entry.id.encode())) % 2**64)
        case RecordingSource() as recording:
            return Recording(recording.path)


def peers_of(robot: str, scene: str, fleet: Fleet) -> dict[str, str]:
    """Other robots that the fleet file puts into the scene, with their routes ("" for their own)."""
    return {
        other.id: other.source.route
        for other in fleet.robots
        if other.id != robot and isinstance(other.source, SimSource) and other.source.scene == scene
    }
