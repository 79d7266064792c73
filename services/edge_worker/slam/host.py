"""What runs inside a SLAM worker process: the instances pinned to it, and answers about their maps."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from common.errors import UsageError
from common.grid.paging import page
from common.grid.raster import Raster
from common.grid.standing import MarkedMap, Places, stands
from common.grid.tiles import encode_counts, encode_occupancy
from common.grid.versions import first_version
from common.wire import Frame, TrajectoryPage, decode, encode
from services.edge_worker.slam.kernel import Kernel
from services.edge_worker.slam.registry import create

RECENT_S = 10.0
"""time over which the mean of a scan is taken: where CPU time is limited, most scans take no longer, but some do"""
TRAJECTORY_ROWS = 4096
"""rows in one page of a trajectory (32 bytes each)"""
IDLE_S = 0.003
"""work on maps that a frame may have to wait for if it comes just then"""
ASKED_S = 0.01
"""the same where the map has been asked for"""
BEHIND_S = 5.0
"""how long a map may stay as it was while it is drawn anew. A worker that was never idle meanwhile has more to do than
it can, so that poses are late anyway: then all is drawn at once"""


@dataclass
class Instance:
    """One robot's SLAM and what has been told about it."""

    kernel: Kernel
    life: int
    shown: MarkedMap
    sketch: Raster
    seq: int = -1
    """last frame taken"""
    final: bool = False
    unprepared: bool = False
    """the kernel may have work left to do for its map"""
    covered: int = -1
    """last frame in what is shown"""
    trajectory: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    """that of what is shown"""
    places: Places | None = None
    """where the robot has stood by then; None when a frame may have changed that"""
    behind: float | None = None
    """since when a newer map has been asked for that is not ready"""
    spent_s: float = 0.0
    recent: deque[tuple[float, float]] = field(default_factory=deque)
    """(end, duration) of scans, s"""


class SlamHost:
    """Called through common.workers; arguments and results are plain msgpack values."""

    def __init__(self) -> None:
        self._instances: dict[str, Instance] = {}

    def warm(self, kernel: str) -> None:
        """Import the kernel and load its compiled code, so that the first robot does not wait for it."""
        from services.edge_worker.slam.warmup import warmup

        create(kernel, {})
        warmup(kernel)

    def open(
        self,
        robot: str,
        life: int,
        kernel: str,
        settings: dict[str, Any],
        seed: int,
        snapshot: bytes | None = None,
    ) -> None:
        """An instance that goes on from a snapshot, or a fresh one; an older one of this robot is forgotten.

        `life` tells its map from any other's. Raises SnapshotRefused.
        """
        made, seq, spent_s = create(kernel, settings, seed), -1, 0.0
        resolution, version = made.map().resolution, first_version(life)
        if snapshot is not None:
            seq, spent_s, state = msgpack.unpackb(snapshot, max_bin_len=len(snapshot))
            made.restore(state)
        marked, sketch = MarkedMap(resolution, version), Raster(resolution, version=version)
        self._instances[robot] = Instance(made, life, marked, sketch, seq, unprepared=True, spent_s=spent_s)

    def close(self, robot: str, life: int) -> None:
        """Forget this instance, not one that was opened after it."""
        if robot in self._instances and self._instances[robot].life == life:
            del self._instances[robot]

    def process(self, robot: str, data: bytes) -> dict[str, Any]:
        """Take one encoded Frame: pose (x, y, theta), whether the scan matched, and the time it took."""
        instance = self._instance(robot)
        frame = decode(data, sender=robot)
        if not isinstance(frame, Frame):
            raise UsageError(f"{robot}: {type(frame).__name__} is no frame")
        instance.unprepared = True
        begin = time.perf_counter()
        estimate = instance.kernel.process(frame)
        end = time.perf_counter()
        instance.seq, instance.final, instance.places = frame.seq, False, None
        instance.spent_s += end - begin
        instance.recent.append((end, end - begin))
        while end - instance.recent[0][0] > RECENT_S:
            instance.recent.popleft()
        return {"pose": [float(v) for v in estimate.pose], "stamp": frame.stamp, "matched": bool(estimate.matched)}

    def snapshot(self, robot: str) -> bytes:
        """What another instance can go on from."""
        instance = self._instance(robot)
        return bytes(msgpack.packb([instance.seq, instance.spent_s, instance.kernel.snapshot()]))

    def finish(self, robot: str, refine: bool = True) -> None:
        """The robot's stream has ended: refine once more; the map is final, also when the refinement fails."""
        instance = self._instance(robot)
        instance.final, instance.places, instance.unprepared = True, None, True
        if refine:
            instance.kernel.finish()

    def idle(self) -> bool:
        """Work a little on maps that are behind; returns whether there may be more to do. Called between requests."""
        for instance in self._instances.values():
            if instance.unprepared:
                instance.unprepared = False  # also when the kernel fails: it will again when the map is asked for
                instance.unprepared = not instance.kernel.prepare(IDLE_S)
                return True
        return False

    def news(self, robot: str) -> dict[str, Any]:
        """Version of the map and what it contains: everything, unless it is being drawn anew after a correction."""
        instance = self._instance(robot)
        if _may_show(instance):
            if instance.places is None:
                instance.trajectory, instance.covered = instance.kernel.trajectory(), instance.seq
                instance.places = stands(instance.trajectory)
            instance.shown.follow(instance.kernel.map(), instance.places)
            instance.sketch.follow(instance.shown.grid)
        grid = instance.shown.grid
        return {
            "version": grid.version,
            "resolution": grid.resolution,
            "seq": instance.covered,
            "final": instance.final,
            "corrections": instance.kernel.corrections.times,
            "corrected_m": instance.kernel.corrections.metres,
            "slam_s": instance.spent_s,
            "scan_s": sum(seconds for _, seconds in instance.recent) / max(1, len(instance.recent)),
        }

    def tiles(self, robot: str, kind: str, since: int, cursor: str, limit_bytes: int) -> dict[str, Any]:
        """One page of changed tiles, of the counts or of the sketch."""
        instance = self._instance(robot)
        told = self.news(robot)
        if kind == "occupancy":
            found = page(instance.sketch, since, cursor, limit_bytes, encode_occupancy)
            told["version"] = instance.sketch.version
        else:
            found = page(instance.shown.grid, since, cursor, limit_bytes, encode_counts)
        return {**told, "tiles": found.tiles, "next": found.next}

    def trajectory(self, robot: str, start: int) -> bytes:
        """An encoded TrajectoryPage from row `start` on."""
        instance = self._instance(robot)
        version = self.news(robot)["version"]
        rows = np.ascontiguousarray(instance.trajectory, dtype=np.float64)
        end = start + TRAJECTORY_ROWS
        return encode(
            TrajectoryPage(
                robot=robot,
                version=version,
                poses=rows[start:end],
                next=end if end < len(rows) else None,
            )
        )

    def _instance(self, robot: str) -> Instance:
        if robot not in self._instances:
            raise UsageError(f"no SLAM instance of {robot} here; ask the edge that the routing table names")
        return self._instances[robot]


def _may_show(instance: Instance) -> bool:
    """Is the kernel's map ready, or has it been waited for in vain? The first and the final one are not waited for."""
    now = time.monotonic()
    if instance.behind is None:
        instance.behind = now
    at_once = instance.final or instance.covered < 0 or now - instance.behind >= BEHIND_S
    if instance.kernel.prepare(ASKED_S) or at_once:
        instance.behind = None
        return True
    return False
