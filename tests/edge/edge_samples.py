"""Messages of an edge's day, and a robot whose spool can be asked."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from types import MappingProxyType

import numpy as np

from common.wire import Frame, LaserScan, MapNotice, RobotProfile, Route, Routes
from common.wire.base import Cover, Epoch
from services.edge_worker.pool import Pool

STREAM, OTHER = "a" * 32, "b" * 32
SCAN = LaserScan(
    angle_min=0.0,
    angle_increment=0.1,
    range_min=0.1,
    range_max=8.0,
    quantum=0.001,
    ranges=np.full(4, 1000, np.uint16),
)


def frame(seq: int, robot: str = "r1", stream: str = STREAM, kind: str = "laser") -> Frame:
    return Frame(robot=robot, stream=stream, seq=seq, stamp=0.1 * seq, kind=kind, scan=SCAN)


def routes(
    n: int, slam: dict[str, str], fuse: dict[str, str] | None = None, epochs: Mapping[str, int] = MappingProxyType({})
) -> Routes:
    """Table (1, n); a robot's route has epoch (1, `epochs[robot]`), by default (1, 1)."""
    fuse = fuse or slam
    made = {
        robot: Route(slam_edge=edge, fuse_edge=fuse[robot], epoch=(1, epochs.get(robot, 1)))
        for robot, edge in slam.items()
    }
    return Routes(epoch=(1, n), routes=made)


def profile(robot: str = "r1", stream: str = STREAM) -> RobotProfile:
    return RobotProfile(robot=robot, stream=stream)


def cover(seq: int, epoch: Epoch = (1, 1), stream: str = STREAM) -> Cover:
    return Cover(stream=stream, seq=seq, epoch=epoch)


def notice(robot: str, edge: str, version: int, final: bool = False, epoch: Epoch = (1, 1)) -> MapNotice:
    return MapNotice(
        robot=robot, edge=edge, epoch=epoch, version=version, resolution=0.05, cover=cover(9, epoch), final=final
    )


@asynccontextmanager
async def watched(pool: Pool) -> AsyncIterator[None]:
    """The pool is open, and its workers are replaced when they die."""
    await pool.open()
    watching = asyncio.create_task(pool.watch())
    try:
        yield
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await pool.close()
