"""What a SLAM kernel is: the one protocol that `graph`, `gmapping` and plugged-in kernels keep.

A kernel's only input is its own robot's frames in order. It is seeded and deterministic: the same frames give
the same map and trajectory, bit for bit, on machines of equal fingerprint.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from common.grid import Grid
from common.wire import Frame
from services.edge_worker.slam.corrections import Corrections


class Estimate(NamedTuple):
    """What a kernel knows after one frame."""

    pose: NDArray[np.float64]
    """(3,) robot base in the kernel's map frame at the frame's stamp: m, m, rad"""
    matched: bool
    """the scan agreed with the map (False: dead reckoning, or the frame held no usable beam)"""


class Kernel(Protocol):
    """One robot's SLAM."""

    @property
    def corrections(self) -> Corrections:
        """What has been moved of what the map showed."""
        ...

    def process(self, frame: Frame) -> Estimate:
        """Take the next frame. A frame without usable beams moves the pose by odometry only."""
        ...

    def finish(self) -> None:
        """The stream has ended: let pending background work take effect and refine once more."""
        ...

    def prepare(self, seconds: float) -> bool:
        """Do for about `seconds` what `map` would have to; returns whether it has nothing left that takes time.

        Neither poses nor the map change by that: it is for moments when no robot waits, and may as well not be called.
        """
        ...

    def map(self) -> Grid:
        """The robot map so far: the same object each time, its versions rising as tiles change."""
        ...

    def trajectory(self) -> NDArray[np.float64]:
        """(n, 4): stamp s, x m, y m, theta rad, one row for every frame taken, corrected up to now."""
        ...

    def snapshot(self) -> bytes:
        """All state, so that `restore` continues bit for bit."""
        ...

    def restore(self, data: bytes) -> None:
        """Take over a snapshot of a kernel of the same name and settings. Raises SnapshotRefused."""
        ...
