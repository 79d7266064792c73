"""What the tests of graph SLAM share: frames of simulated robots and of logs, and running a kernel over them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.evaluation.trajectory import ErrorStats, absolute_error
from common.sim import SimulatedRobot, load_scene
from common.wire import Frame
from services.edge_worker.slam.graph.graph_slam import GraphSlam
from services.robot_agent.packing import pack

STREAM = "0" * 32


@cache
def robot(scene: str = "apartment", **how: Any) -> SimulatedRobot:
    return SimulatedRobot(load_scene(scene), "r1", 1, **{"duration_s": 40.0, **how})


@cache
def driven(scene: str = "apartment", **how: Any) -> tuple[Frame, ...]:
    """Frames of a simulated robot."""
    return tuple(pack(sweep, "r1", STREAM, seq) for seq, sweep in enumerate(robot(scene, **how).sweeps()))


def run(frames: Iterable[Frame], **settings: Any) -> GraphSlam:
    """A kernel that has taken all frames."""
    kernel = GraphSlam.create(settings, 0)
    for frame in frames:
        kernel.process(frame)
    return kernel


def error(kernel: GraphSlam, truth: SimulatedRobot) -> ErrorStats:
    """Of the kernel's trajectory, after one fit."""
    rows = kernel.trajectory()
    return absolute_error([rows], [np.column_stack([rows[:, 0], truth.poses(rows[:, 0])])])


def changed(frame: Frame, ranges: NDArray[np.floating] | None = None, **fields: Any) -> Frame:
    """The frame with other ranges (metres) or other fields."""
    if ranges is not None:
        assert frame.scan is not None
        counts = frame.scan.quantise(np.asarray(ranges, np.float64), frame.scan.quantum)
        fields["scan"] = frame.scan.model_copy(update={"ranges": counts})
    return frame.model_copy(update=fields)
