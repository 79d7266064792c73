"""The parent's side of one worker process."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import socket
import sys
from typing import Any, Protocol

import msgpack

from common.errors import RecslamError, WorkerDied
from common.workers.framing import HEAD

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "BLIS_NUM_THREADS"), "1"
)
"""Workers are as many as cores: threads inside them would only fight."""


class Process(Protocol):
    """What a worker needs to know of its process."""

    @property
    def pid(self) -> int: ...

    @property
    def returncode(self) -> int | None: ...

    def kill(self) -> None: ...

    async def wait(self) -> int: ...


class WorkerError(RecslamError):
    """A call failed inside the worker; the worker itself goes on."""


class Worker:
    """One process that serves the methods of a class, in the order of the calls.

    `target` is "module:Class". Start with `await Worker.start(target)`, end with `await worker.close()`.
    """

    def __init__(self, target: str, process: Process, channel: socket.socket) -> None:
        self.target = target
        self.process = process
        self._channel = channel
        self._writer: asyncio.StreamWriter | None = None
        self._waiting: dict[int, tuple[str, asyncio.Future[Any]]] = {}
        """calls sent and not answered, in order: number → method, its answer"""
        self._ids = itertools.count(1)
        self._ready: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.gone = asyncio.Event()
        """set once the process has ended"""
        self._reader_task = asyncio.create_task(self._read(), name=f"worker[{process.pid}]")

    @classmethod
    async def start(cls, target: str) -> Worker:
        """A worker whose process has been started; it is ready when the first call returns."""
        return cls(target, *await spawn(target))

    async def ready(self) -> int:
        """Wait until the class has been made; gives the process id. Raises WorkerDied."""
        return await asyncio.shield(self._ready)

    @property
    def at_work(self) -> tuple[int, str] | None:
        """Number and method of the call that the process works on; None when it has none."""
        return next(((number, method) for number, (method, _) in self._waiting.items()), None)

    async def call(self, method: str, /, **arguments: Any) -> Any:
        """Call a method in the worker. Raises WorkerError when it raised, WorkerDied when the process ended."""
        await self.ready()
        if self.gone.is_set() or self._writer is None:
            raise WorkerDied(f"worker {self.process.pid} ({self.target}) has ended")
        request_id = next(self._ids)
        data = msgpack.packb([request_id, method, arguments])  # what cannot be sent must not count as sent
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting[request_id] = method, future
        self._writer.write(HEAD.pack(len(data)) + data)
        try:
            with contextlib.suppress(ConnectionError):  # the reader task tells of the death
                await self._writer.drain()
            return await future
        finally:
            self._waiting.pop(request_id, None)

    async def close(self) -> None:
        """End the process and wait for it; what it had not answered is lost."""
        if not self.gone.is_set():  # afterwards its number may be another process's
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()
        await self.process.wait()
        await self._reader_task

    async def _read(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._channel, limit=1 << 20)
        try:
            while True:
                (size,) = HEAD.unpack(await reader.readexactly(HEAD.size))
                request_id, ok, result = msgpack.unpackb(await reader.readexactly(size), strict_map_key=False)
                self._answer(request_id, ok, result)
        except (asyncio.IncompleteReadError, OSError):
            pass
        finally:
            self._writer.close()
            code = await self.process.wait()
            self._fail(WorkerDied(f"worker {self.process.pid} ({self.target}) ended with {code}"))
            self.gone.set()

    def _answer(self, request_id: int, ok: bool, result: Any) -> None:
        if request_id == 0:
            self._ready.set_result(result)
            return
        _, future = self._waiting.get(request_id, ("", None))
        if future is not None and not future.done():
            if ok:
                future.set_result(result)
            else:
                future.set_exception(WorkerError(result))

    def _fail(self, error: WorkerDied) -> None:
        for future in [self._ready, *(future for _, future in self._waiting.values())]:
            if not future.done():
                future.set_exception(error)
        if self._ready.done() and self._ready.exception() is not None:
            self._ready.exception()  # retrieved: a worker that nobody called may die unheard


async def spawn(target: str, *arguments: str) -> tuple[asyncio.subprocess.Process, socket.socket]:
    """A process for "module:Class" and the socket to it."""
    ours, theirs = socket.socketpair()
    try:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "common.workers.child",
            target,
            str(theirs.fileno()),
            *arguments,
            pass_fds=(theirs.fileno(),),
            stdin=asyncio.subprocess.DEVNULL,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # a Ctrl-C at the terminal is for the parent, who closes us in order
        )
    except BaseException:
        ours.close()
        raise
    finally:
        theirs.close()
    return process, ours
