"""Query replies, paged: a page stays below MAX_PAGE_BYTES, `next` asks for the page after it."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict

from common.wire.arrays import ArrayOf
from common.wire.base import Covers, Message, Name, Part, StreamId


class FramePage(Message):
    """Frames out of a spool, each encoded as it was sent."""

    robot: Name
    stream: StreamId
    frames: tuple[bytes, ...]
    oldest: int
    """first sequence number still in the spool"""
    next: int | None = None


class Tile(Part):
    x: int
    y: int
    version: int
    data: bytes
    """see common.grid.tiles; empty: the tile has been emptied"""


class TilePage(Message):
    """Changed tiles of a grid, oldest change first."""

    source: str
    kind: Literal["counts", "occupancy"]
    resolution: float
    version: int
    """of the whole grid, once all pages are taken"""
    tiles: tuple[Tile, ...]
    covers: Covers
    final: bool
    world_epoch: int = 0
    next: str | None = None
    """pass as `cursor` for the page after this one"""


class TrajectoryPage(Message):
    """Corrected poses of a robot's base in its own map frame, one row a processed frame."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    robot: Name
    version: int
    poses: Annotated[np.ndarray, ArrayOf("float64", columns=4)]
    """(n, 4): stamp s, x m, y m, theta rad"""
    next: int | None = None


class Refusal(Message):
    """An error reply: what was wrong with the query."""

    reason: str
