"""A warm process that workers are forked from: they are ready at once, and share its memory until they write to it.

It is spawned as every worker is, makes the class, calls its `warm`, and from then on only forks: it has no thread, and
no connection but the one to its parent, so that a fork of it is whole. When it dies, the workers forked from it go on.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from collections import deque
from typing import Any

import msgpack

from common.errors import WorkerDied
from common.workers.framing import HEAD
from common.workers.worker import Worker, WorkerError, spawn

UNKNOWN = -1
"""code of a process whose end nobody saw"""


class Forked:
    """A worker's process, which is not ours to wait for: the template does, and tells."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.over = asyncio.Event()
        """set when the process has ended, or nobody is left to tell: then its socket does"""

    def kill(self) -> None:
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)

    async def wait(self) -> int:
        await self.over.wait()
        return UNKNOWN if self.returncode is None else self.returncode


class Template:
    """The parent's side. Start with `await Template.start(target, ...)`, end with `await template.close()`."""

    def __init__(self, target: str, process: asyncio.subprocess.Process, channel: socket.socket) -> None:
        self.target = target
        self.process = process
        self.gone = asyncio.Event()
        """set once the process has ended"""
        self._channel = channel
        self._ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._asked: deque[asyncio.Future[Forked]] = deque()
        self._living: dict[int, Forked] = {}
        self._reader_task = asyncio.create_task(self._read(), name=f"template[{process.pid}]")

    @classmethod
    async def start(cls, target: str, **warm: Any) -> Template:
        """A template of "module:Class" that is warm. Raises WorkerError when `warm(**warm)` failed, WorkerDied."""
        process, channel = await spawn(target, msgpack.packb(warm).hex())
        template = cls(target, process, channel)
        try:
            await template._ready
        except BaseException:
            await template.close()
            raise
        return template

    async def fork(self) -> Worker:
        """A worker that is ready. Raises WorkerDied when the template has ended, WorkerError when it could not fork."""
        if self.gone.is_set():
            raise self._died()
        ours, theirs = socket.socketpair()
        asked: asyncio.Future[Forked] = asyncio.get_running_loop().create_future()
        try:
            socket.send_fds(self._channel, [b"f"], [theirs.fileno()])
            self._asked.append(asked)
            process = await asked
        except OSError as error:
            ours.close()
            raise self._died() from error
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        return Worker(self.target, process, ours)

    async def close(self) -> None:
        """End the process and wait for it. Workers forked from it stay."""
        if self.process.returncode is None:
            self.process.kill()
        await self.process.wait()
        await self._reader_task

    async def _read(self) -> None:
        reader, writer = await asyncio.open_connection(sock=self._channel)
        try:
            while True:
                (size,) = HEAD.unpack(await reader.readexactly(HEAD.size))
                self._hear(*msgpack.unpackb(await reader.readexactly(size)))
        except (asyncio.IncompleteReadError, OSError):
            pass
        finally:
            writer.close()
            await self.process.wait()
            self.gone.set()
            waiting: list[asyncio.Future[Any]] = [self._ready, *self._asked]
            for future in waiting:
                _answer(future, self._died())
            for each in self._living.values():
                each.over.set()

    def _hear(self, what: str, pid: int, detail: Any) -> None:
        if what == "ready":
            _answer(self._ready, None)
        elif what == "not ready":
            _answer(self._ready, WorkerError(detail))
        elif what == "not forked":
            _answer(self._asked.popleft(), WorkerError(detail))
        elif what == "forked":
            self._living[pid] = each = Forked(pid)
            _answer(self._asked.popleft(), each)
        elif what == "ended":
            each = self._living.pop(pid)
            each.returncode = detail
            each.over.set()

    def _died(self) -> WorkerDied:
        return WorkerDied(f"template {self.process.pid} ({self.target}) has ended")


def _answer(asked: asyncio.Future[Any], answer: Any) -> None:
    """Nothing when nobody waits any more: a worker forked for nobody ends by itself, as its socket is closed."""
    if asked.done():
        return
    if isinstance(answer, Exception):
        asked.set_exception(answer)
    else:
        asked.set_result(answer)
