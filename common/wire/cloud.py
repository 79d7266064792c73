"""What the cloud merger sends."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from common.wire.base import Covers, Message, Name, Part
from common.wire.edge import Component
from common.wire.link import LinkStatus


class FixedPose(Part):
    """A world transform in whole micrometres and nanoradians, so that all edges render the same cells."""

    x_um: int
    y_um: int
    theta_nrad: int

    @classmethod
    def of(cls, x: float, y: float, theta: float) -> FixedPose:
        theta = math.atan2(math.sin(theta), math.cos(theta))
        return cls(x_um=round(x * 1e6), y_um=round(y * 1e6), theta_nrad=round(theta * 1e9))

    def pose(self) -> tuple[float, float, float]:
        return self.x_um * 1e-6, self.y_um * 1e-6, self.theta_nrad * 1e-9


Shift = Annotated[int, Field(ge=-10_000_000, le=10_000_000)]
"""micrometres that a warp moves a point by; more than 10 m is no drift"""


class Warp(Part):
    """How a bent map is straightened: shifts at the nodes of a lattice in the map's own frame, linear in between.

    Beyond the lattice its border holds. In whole micrometres, so that all edges render the same cells.
    """

    spacing_m: Annotated[float, Field(ge=0.5, le=50)]
    x: Annotated[int, Field(ge=-100_000, le=100_000)]
    y: Annotated[int, Field(ge=-100_000, le=100_000)]
    """the first node lies at (x, y) times the spacing"""
    columns: Annotated[int, Field(ge=2)]
    shifts_um: tuple[Shift, ...]
    """along x and along y of each node, row by row from the first"""

    @model_validator(mode="after")
    def _is_lattice(self) -> Self:
        rows, rest = divmod(len(self.shifts_um), 2 * self.columns)
        if rest or rows < 2:
            raise ValueError(
                f"{len(self.shifts_um)} shifts are no lattice of {self.columns} columns and two rows or more"
            )
        return self


class Placed(Part):
    """Where a robot's map lies in the world."""

    transform: FixedPose
    """robot map frame in the world frame"""
    component: str
    version: int
    """robot map version that the transform was solved for"""
    warp: Warp | None = None
    """applied before the transform; None: the map is placed as it is"""


class Transforms(Message):
    """Robot → world transforms; a new world epoch whenever one changes."""

    world_epoch: int
    final: bool
    """solved canonically from final robot maps"""
    resolution: float
    """of the world lattice, metres"""
    robots: dict[Name, Placed]
    components: tuple[Component, ...]
    reason: str = ""


class StageTimes(Part):
    """One robot's or edge's times on the way to a global map (paper, Eqs. 1-3), seconds."""

    pack: float = 0.0
    transfer: float = 0.0
    slam: float = 0.0
    fuse: float = 0.0


class Trace(Part):
    """How a global map version came about."""

    robots: dict[Name, StageTimes]
    edges: dict[Name, StageTimes]
    cloud: StageTimes
    total_s: float
    """t_c of Eq. 3"""
    critical: tuple[str, ...]
    """names along the path that determined the total"""


class GlobalMapNotice(Message):
    """A new version of the global map stands ready at `cloud/map`."""

    version: int
    world_epoch: int
    final: bool
    resolution: float
    digest: str
    """SHA-256 over all tiles' counts"""
    components: tuple[Component, ...]
    covers: Covers
    trace: Trace
    changes: tuple[str, ...] = ()
    """of robot maps since the version before, above all what SLAM has corrected in them: walls may have moved although
    the world has not"""


class CloudStatus(Message):
    version: int
    world_epoch: int
    robots: tuple[Name, ...]
    components: int
    cpu_s: float
    rss_mb: float
    stages: dict[str, float]
    counters: dict[str, int]
    bytes_in: int = 0
    links: tuple[LinkStatus, ...] = ()
    """ways from edges"""
    problems: tuple[str, ...] = ()
