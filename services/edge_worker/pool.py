"""The pool of SLAM worker processes of one edge, forked from a warm template: a dead one is replaced at once."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Any

from common.errors import WorkerDied
from common.workers import Template, Worker, WorkerError
from services.edge_worker.patience import Patience, activity

TARGET = "services.edge_worker.slam.host:SlamHost"

RETRY_S = 1.0
LOOK_S = 0.5
LIMITED = "process"
"""the call that may not take for ever: one scan"""

log = logging.getLogger(__name__)


class Pool:
    """`size` workers by number. `open` it, let `watch` run, and `close` it.

    `on_death(number, how)` is called on the loop once a worker has died and another stands under its number. A worker
    that spends more than `limit_s` on one scan is killed.
    """

    def __init__(
        self, size: int, kernel: str, limit_s: float, on_death: Callable[[int, str], None], target: str = TARGET
    ) -> None:
        self._size, self._kernel, self._limit_s, self._on_death = size, kernel, limit_s, on_death
        self._target = target
        self._workers: list[Worker] = []
        self._template: Template | None = None
        self._starting = asyncio.Lock()
        """held while a template is being started"""
        self._forks = True
        """False for a kernel that cannot be forked, as it has threads: each of its workers is spawned and warms up"""

    async def open(self) -> None:
        """Start all workers."""
        for _ in range(self._size):
            self._workers.append(await self._warm_worker())

    async def watch(self) -> None:
        """Replace workers that die or are stuck, for ever. Raises what `on_death` does, in an exception group."""
        async with asyncio.TaskGroup() as guards:
            for number in range(self._size):
                guards.create_task(self._replace_when_dead(number), name=f"guard of worker {number}")

    async def call(self, number: int, method: str, /, **arguments: Any) -> Any:
        """Call a method of the worker with this number. Raises WorkerError, or WorkerDied."""
        return await self._workers[number].call(method, **arguments)

    def pids(self) -> list[int]:
        return [worker.process.pid for worker in self._workers]

    async def close(self) -> None:
        """End all processes; nobody watches any more."""
        await asyncio.gather(*(worker.close() for worker in self._workers))
        if self._template is not None:
            await self._template.close()

    async def _warm_worker(self) -> Worker:
        async with self._starting:
            if self._forks and (self._template is None or self._template.gone.is_set()):
                try:
                    self._template = await Template.start(self._target, kernel=self._kernel)
                except WorkerError as error:
                    log.warning("SLAM workers are not forked", extra={"reason": error})
                    self._forks = False
        if self._forks and self._template is not None:
            return await self._template.fork()
        worker = await Worker.start(self._target)
        try:
            await worker.call("warm", kernel=self._kernel)
        except BaseException:
            await worker.close()
            raise
        return worker

    async def _replace_when_dead(self, number: int) -> None:
        while True:
            worker = self._workers[number]
            how = await self._until_gone(worker)
            log.error("SLAM worker died", extra={"worker": number, "how": how})
            self._workers[number] = await self._next_worker()
            self._on_death(number, how)

    async def _until_gone(self, worker: Worker) -> str:
        """How it ended; one that is stuck on a scan is ended."""
        patience, how = Patience(self._limit_s), ""
        while not worker.gone.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(worker.gone.wait(), LOOK_S)
            turn, method = worker.at_work or (None, "")
            seen = activity(worker.process.pid)
            if seen is None or worker.gone.is_set():
                continue
            if patience.stuck(turn if method == LIMITED else None, seen, asyncio.get_running_loop().time()):
                how = f"killed: it spent more than {self._limit_s:g} s on one scan"
                with contextlib.suppress(ProcessLookupError):  # it has ended just now
                    worker.process.kill()
                await worker.gone.wait()
        code = worker.process.returncode
        return how or (f"ended with code {code}" if code is not None else "ended, and nobody saw how")

    async def _next_worker(self) -> Worker:
        """Another one; what cannot be started is tried again."""
        while True:
            try:
                return await self._warm_worker()
            except (WorkerDied, WorkerError, OSError) as error:
                log.error("a SLAM worker did not come up; trying again", extra={"reason": error})
                await asyncio.sleep(RETRY_S)
