"""Several robots out of one recorded run: cut it by time, and take from each part where it began."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from common.errors import UsageError
from common.geometry import between, compose
from common.sweep import Sweep

START_SPREAD_M = 50.0
"""Hidden start frames lie within this of the origin in x and in y."""


def cut(sweeps: Iterable[Sweep], part: int, parts: int) -> list[Sweep]:
    """The sweeps of time segment `part` (0 .. parts - 1) of `parts` equally long ones.

    A segment takes what is stamped at or after its beginning and before the next one's; the last takes the end
    as well. Odometry from before the first sweep of a segment goes with the robot before.
    """
    if not 0 <= part < parts:
        raise UsageError(f"part {part} of {parts}: parts count from 0 to {parts - 1}")
    sweeps = list(sweeps)
    if not sweeps:
        return []
    first, last = sweeps[0].stamp, sweeps[-1].stamp
    edges = first + (last - first) * np.arange(1, parts) / parts
    owner = np.searchsorted(edges, [sweep.stamp for sweep in sweeps], side="right")
    mine = [sweep for sweep, robot in zip(sweeps, owner, strict=True) if robot == part]
    if part and mine and mine[0].odometry is not None:
        start = edges[part - 1]
        mine[0] = replace(mine[0], odometry=mine[0].odometry[mine[0].odometry[:, 0] >= start])
    return mine


def hide_start(sweeps: Iterable[Sweep], seed: int) -> list[Sweep]:
    """The same sweeps with odometry in a start frame of its own, drawn from `seed`: one rigid motion for all.

    The first sample lands on a random pose that tells nothing of where it was. Ranges and stamps stay.
    """
    sweeps = list(sweeps)
    first = next((s.odometry[0, 1:] for s in sweeps if s.odometry is not None and len(s.odometry)), None)
    if first is None:
        return sweeps
    rng = np.random.default_rng(seed)
    start = np.append(rng.uniform(-START_SPREAD_M, START_SPREAD_M, 2), rng.uniform(-np.pi, np.pi))
    hidden = []
    for sweep in sweeps:
        if sweep.odometry is not None:
            moved = compose(start, between(first, sweep.odometry[:, 1:]))
            sweep = replace(sweep, odometry=np.column_stack([sweep.odometry[:, 0], moved]))
        hidden.append(sweep)
    return hidden
