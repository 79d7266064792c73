"""A source of given sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from common.sweep import LaserGeometry, Sweep
from services.robot_agent.sources.source import SourceProfile

GEOMETRY = LaserGeometry(angle_min=-1.5, angle_increment=0.1, range_min=0.1, range_max=8.0)


class ListSource:
    def __init__(self, sweeps: Sequence[Sweep], can_wait: bool = True) -> None:
        self.profile = SourceProfile("list", "laser", 8.0, can_wait)
        self._sweeps = sweeps

    def sweeps(self) -> Iterator[Sweep]:
        return iter(self._sweeps)


def sweeps(count: int, step_s: float = 0.1, beams: int = 30) -> list[Sweep]:
    rng = np.random.default_rng(5)
    return [Sweep(i * step_s, GEOMETRY, rng.uniform(0, 8, beams).astype(np.float32)) for i in range(count)]
