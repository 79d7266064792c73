"""A robot that drives one stretch of a CARMEN log."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from common.config import CarmenSource
from common.formats.carmen import CarmenLog
from common.formats.segments import cut, hide_start
from common.sweep import Sweep
from services.robot_agent.sources.source import SourceProfile

logger = logging.getLogger(__name__)


class CarmenRobot:
    """Reads the log whole; its odometry starts in a random frame drawn from `seed` where the entry asks for it.

    Raises BadFile when the log cannot be read, UsageError when there is no such part.
    """

    def __init__(self, entry: CarmenSource, seed: int) -> None:
        log = CarmenLog(entry.path)
        logger.log(logging.WARNING if log.malformed else logging.INFO, log.summary())
        sweeps = cut(log, entry.part, entry.parts)
        self._sweeps = hide_start(sweeps, seed) if entry.hide_start else sweeps
        self.profile = SourceProfile(
            name=f"carmen {entry.path.name}, part {entry.part} of {entry.parts}",
            sensor=log.laser,
            range_max=max((sweep.geometry.range_max for sweep in sweeps), default=0.0),
            can_wait=True,
        )

    def sweeps(self) -> Iterator[Sweep]:
        return iter(self._sweeps)
