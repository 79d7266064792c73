"""A simulated robot drives as its entry in the fleet file says."""

from __future__ import annotations

from itertools import islice

import numpy as np

from common.config import SimSource
from services.robot_agent.sources.simulator import Simulator


def wheels(noise: str) -> np.ndarray:
    """Odometry (n, 4) of the first 40 sweeps."""
    source = SimSource.model_validate({"scene": "apartment", "noise": noise})
    sweeps = islice(Simulator(source, "r1", 1, {}).sweeps(), 40)
    return np.vstack([sweep.odometry for sweep in sweeps])


def test_wheels_are_as_wrong_as_the_entry_says() -> None:
    true, good, hostile = (wheels(noise) for noise in ("none", "good", "hostile"))
    off = [float(np.hypot(*(told - true)[-1, 1:3])) for told in (good, hostile)]
    assert 0 < off[0] < off[1]
