"""What the SLAM state machine asks of the kernels in the pool; each call gives the event that came of it, if any."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from typing import Any

from common.bus import Bus, keys
from common.config import Fleet
from common.errors import WorkerDied
from common.wire import Frame, PoseUpdate, encode
from common.workers import WorkerError
from services.edge_worker.checkpoints import Checkpoints, InMemory, Kept, OnDisk
from services.edge_worker.instance import Instance
from services.edge_worker.instructions import Feed, Finish, Instruction, Keep, Open, Release
from services.edge_worker.pool import Pool
from services.edge_worker.state import EdgeState, FrameDone, InstanceFinished, KeptDurably, Opened

RETRY_S = 1.0

log = logging.getLogger(__name__)


class Kernels:
    """The kernels of one edge. None is given where a worker has died: its guard tells, and all in it begins anew."""

    def __init__(self, fleet: Fleet, state: EdgeState, pool: Pool, bus: Bus, problem: Callable[[str], None]) -> None:
        """`problem` is told of what the status shall show."""
        self._fleet, self._state, self._pool, self._bus, self._problem = fleet, state, pool, bus, problem
        folder = fleet.edge.checkpoints
        self._checkpoints: Checkpoints = InMemory() if folder is None else OnDisk(folder)

    async def open(self, step: Open) -> Opened | None:
        """From the newest checkpoint that can be taken over, or a fresh one."""
        try:
            for kept in [] if step.afresh else await self._newest(step):
                if self._instance(step) is None:
                    return None  # released, or begun anew meanwhile: what came after must not be replaced
                if await self._open_from(step, kept):
                    return Opened(step.robot, step.life, kept.checkpoint, self._checkpoints.durable)
            if self._instance(step) is None:
                return None
            await self._open(step)
        except WorkerDied:
            return None
        return Opened(step.robot, step.life)

    async def process(self, step: Feed) -> FrameDone | None:
        instance = self._instance(step)
        if instance is None:
            return None  # begun anew meanwhile
        frame = step.frame
        try:
            done = await self._pool.call(instance.worker, "process", robot=step.robot, data=encode(frame))
        except WorkerDied:
            return None
        except WorkerError as error:
            self._problem(f"robot/{step.robot}: frame {frame.seq} set aside: {error}")
            return FrameDone(step.robot, step.life, frame.seq, failed=True)
        self._tell_pose(frame, done["pose"])
        return FrameDone(step.robot, step.life, frame.seq)

    async def keep(self, step: Keep) -> KeptDurably | None:
        """Put the kernel among the checkpoints; when that fails, the one before is still there."""
        instance = self._instance(step)
        if instance is None:
            return None
        try:
            snapshot = await self._pool.call(instance.worker, "snapshot", robot=step.robot)
            await self._checkpoints.keep(step.robot, Kept(step.checkpoint, snapshot))
        except WorkerDied:
            return None
        except (WorkerError, OSError) as error:
            self._problem(f"robot/{step.robot}: no checkpoint at frame {step.checkpoint.seq}: {error}")
            return None
        return KeptDurably(step.robot, step.life, step.checkpoint.seq) if self._checkpoints.durable else None

    async def finish(self, step: Finish) -> InstanceFinished | None:
        instance = self._instance(step)
        if instance is None:
            return None
        if not step.refine:
            self._problem(f"robot/{step.robot}: last refinement set aside: SLAM workers have died of it")
        try:
            await self._pool.call(instance.worker, "finish", robot=step.robot, refine=step.refine)
        except WorkerDied:
            return None
        except WorkerError as error:
            self._problem(f"robot/{step.robot}: last refinement failed: {error}")
        return InstanceFinished(step.robot, step.life)

    async def close(self, step: Release) -> None:
        await self._pool.call(step.worker, "close", robot=step.robot, life=step.life)

    async def _newest(self, step: Open) -> list[Kept]:
        """What there is to go on from. A disk that does not answer is waited for: robots have forgotten what it has."""
        said = ""
        while self._instance(step) is not None:
            try:
                found, wrong = await self._checkpoints.newest(step.robot, step.stream)
            except OSError as error:
                if str(error) != said:
                    said = str(error)
                    self._problem(f"robot/{step.robot}: edge.checkpoints: {error}; its map waits for them")
                await asyncio.sleep(RETRY_S)
                continue
            for what in wrong:
                self._problem(f"robot/{step.robot}: {what}")
            return found
        return []

    async def _open_from(self, step: Open, kept: Kept) -> bool:
        """False, and told, when the kernel does not take the checkpoint."""
        try:
            await self._open(step, snapshot=kept.snapshot)
        except WorkerError as error:
            self._problem(f"robot/{step.robot}: checkpoint at frame {kept.checkpoint.seq} refused: {error}")
            return False
        return True

    async def _open(self, step: Open, **more: Any) -> None:
        config = self._fleet.slam
        await self._pool.call(
            step.worker,
            "open",
            robot=step.robot,
            life=step.life,
            kernel=config.kernel,
            settings=config.settings,
            seed=self._fleet.seed,
            **more,
        )

    def _instance(self, step: Instruction) -> Instance | None:
        """The instance that the instruction is meant for, while it is in that life."""
        instance = self._state.instances.get(step.robot)
        return instance if instance is not None and instance.life == step.life else None

    def _tell_pose(self, frame: Frame, pose: list[float]) -> None:
        if not all(map(math.isfinite, pose)):
            self._problem(f"robot/{frame.robot}: no pose after frame {frame.seq}: {pose}")
            return
        x, y, theta = pose
        edge = self._state.edge
        update = PoseUpdate(robot=frame.robot, edge=edge, seq=frame.seq, stamp=frame.stamp, pose=(x, y, theta))
        self._bus.put(keys.edge_pose(edge, frame.robot), update)
