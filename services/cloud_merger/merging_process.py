"""The process that computes for the cloud; when it has died another takes its place, with nothing in it."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from common.errors import WorkerDied
from common.workers import Worker

TARGET = "services.cloud_merger.merge_host:MergeHost"

log = logging.getLogger(__name__)


class MergingProcess:
    """Start with `await process.start()`, end with `await process.close()`."""

    def __init__(self, settings: dict[str, Any]) -> None:
        """`settings` are the fusion's."""
        self._settings = settings
        self._worker: Worker | None = None
        """only a warm one: what a process is asked for before it is set up would be lost"""
        self._starting = asyncio.Lock()

    async def start(self) -> None:
        """Raises WorkerDied, WorkerError or OSError when it does not come up."""
        worker = await Worker.start(TARGET)
        try:
            await worker.call("configure", settings=self._settings)
            await worker.call("warm")
        except BaseException:
            await worker.close()
            raise
        self._worker = worker

    async def replaced(self) -> bool:
        """Start another if it has died; True for the one who did. Raises as `start` does: then ask again."""
        async with self._starting:
            if self._worker is not None and not self._worker.gone.is_set():
                return False
            self._worker = None
            log.error("the merging process died; starting another")
            await self.start()
            return True

    def up(self) -> Worker:
        """The present one, for work of several calls: in another one they would not find what the first has left.

        Raises WorkerDied while there is none.
        """
        if self._worker is None:
            raise WorkerDied("the merging process is not up")
        return self._worker

    def pids(self) -> list[int]:
        return [self._worker.process.pid] if self._worker is not None else []

    async def close(self) -> None:
        if self._worker is not None:
            await self._worker.close()
