"""A process that computes for a service; when it has died another takes its place, with nothing in it."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from common.errors import WorkerDied
from common.workers.worker import Worker

log = logging.getLogger(__name__)


class WarmWorker:
    """Start with `await warm.start()`, end with `await warm.close()`.

    `what` it is called; its class `target` has methods `configure(settings)` and `warm()`.
    """

    def __init__(self, what: str, target: str, settings: dict[str, Any]) -> None:
        self._what, self._target, self._settings = what, target, settings
        self._worker: Worker | None = None
        self.warm = False
        """the process is set up: what it is asked for before would be lost"""
        self._starting = asyncio.Lock()

    async def start(self) -> None:
        """Raises WorkerDied, WorkerError or OSError when it does not come up."""
        self._worker = worker = await Worker.start(self._target)
        try:
            await worker.call("configure", settings=self._settings)
            await worker.call("warm")
        except BaseException:
            self._worker = None
            await worker.close()
            raise
        self.warm = True

    async def replaced(self) -> bool:
        """Start another if it has died; True for the one who did. Raises as `start` does: then ask again."""
        async with self._starting:
            if self._worker is not None and not self._worker.gone.is_set():
                return False
            self._worker, self.warm = None, False
            log.error("the %s process died; starting another", self._what)
            await self.start()
            return True

    def up(self) -> Worker:
        """The present one, for work of several calls: in another one they would not find what the first has left.

        Raises WorkerDied while there is none.
        """
        if self._worker is None or not self.warm:
            raise WorkerDied(f"the {self._what} process is not up")
        return self._worker

    def pids(self) -> list[int]:
        return [self._worker.process.pid] if self._worker is not None else []

    async def close(self) -> None:
        if self._worker is not None:
            await self._worker.close()
