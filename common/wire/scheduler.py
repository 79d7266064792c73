"""What the scheduler sends."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import ConfigDict

from common.wire.arrays import ArrayOf
from common.wire.base import Epoch, Message, Name, Part


class Route(Part):
    """Where one robot's frames and map go."""

    slam_edge: Name
    fuse_edge: Name
    epoch: Epoch
    """epoch at which this robot's SLAM edge last changed"""


class Routes(Message):
    """The routing table."""

    epoch: Epoch
    routes: dict[Name, Route]


class OverlapMatrix(Message):
    """w(u, v) = |A∩B| / (|A|+|B|) over known cells, 0 to 0.5; IoU = w / (1 - w)."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    robots: tuple[Name, ...]
    weights: Annotated[np.ndarray, ArrayOf("float64", max_rows=4096 * 4096)]
    """row-major square matrix, flattened"""
    source: dict[str, int]
    """how many pairs were estimated from what"""


class Plan(Message):
    """Why the routing table is as it is."""

    epoch: Epoch
    policy: str
    groups: dict[Name, tuple[Name, ...]]
    """fusing edge → robots"""
    slam: dict[Name, Name]
    """robot → edge that runs its SLAM"""
    in_group: dict[Name, float]
    """fusing edge → sum of overlaps within its group"""
    cut: float
    """sum of overlaps across groups, each pair once (Eq. 5)"""
    predicted: dict[str, float]
    """stage times in seconds"""
    alternative: str
    reason: str
    seconds: float
    """time to make it"""


class SchedulerStatus(Message):
    epoch: Epoch
    policy: str
    robots: dict[Name, str]
    """robot → alive, departing or gone"""
    edges: dict[Name, str]
    plans: int
    moved: int
    stages: dict[str, float]
    counters: dict[str, int]
    measured: dict[str, float]
    """what plans rest on: speeds of edges, seconds, bytes/s"""
    problems: tuple[str, ...] = ()
