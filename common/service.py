"""How every service starts, stops and fails: the same arguments, signals, exit codes and parent watch.

Exit codes: 0 stopped as asked (SIGTERM, SIGINT or its work done), 1 a fault of ours (with traceback),
2 something that the operator can mend (one line on stderr), 130 a second SIGINT.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import logging
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

from common.bus import Bus, keys
from common.bus.intake import Received
from common.config import Fleet, load
from common.errors import PeerError, UsageError
from common.heartbeat import beat
from common.parent import watch_parent
from common.telemetry import LogFormat, setup_logging
from common.wire import Message

ENDPOINT = "RECSLAM_ENDPOINT"
"""environment name of the router's endpoint; goes before the fleet file, after the command line"""
STATUS_S = 1.0
"""between two statuses of a service"""

log = logging.getLogger(__name__)


class Service:
    """A service on the bus: it opens, works in tasks until `stop` is set, and closes, also when a task fails."""

    def __init__(self, bus: Bus, stop: asyncio.Event) -> None:
        self.bus, self._stop, self._tasks = bus, stop, asyncio.TaskGroup()

    async def run(self) -> None:
        """Return once `stop` is set. Raises what opening or a task raises, in an exception group."""
        try:
            async with self._tasks:
                if not await until_stopped(self._open(), self._stop):
                    log.info("ready")
                    self._begin()
                    await self._stop.wait()
                raise _Stopped  # ends all tasks
        except* _Stopped:
            pass
        finally:
            await self._close()

    async def _open(self) -> None:
        """Start what takes time; broken off when the service is stopped meanwhile."""

    def _begin(self) -> None:
        """Start the tasks."""

    async def _close(self) -> None:
        """End what `_open` has started, or was about to."""

    def _heard(self, received: Received) -> None:
        """Take a message of a key that is heard."""

    def _seen(self, tier: str, name: str, alive: bool) -> None:
        """A peer of this tier ("robot", "edge") has come or gone."""

    def _linked(self, up: bool) -> None:
        """The router is there, or is lost."""

    async def _refuse_second(self, status_key: str, timeout_s: float) -> None:
        """Two under one name would undo each other's work. Raises UsageError where another one lives."""
        if await living(self.bus, status_key, timeout_s):
            raise UsageError(f"another {status_key.removesuffix('/status')} is there; stop that one first")

    def _start(self, work: Coroutine[Any, Any, None], name: str) -> None:
        """A task that ends with the service; when it fails, the service does."""
        self._tasks.create_task(work, name=name)

    def _follow(self, *key_exprs: str) -> None:
        """Have `_heard` called with the latched values of these keys, and with each new one."""
        for key_expr in key_exprs:
            self._start(self._watch(key_expr), f"hear {key_expr}")

    def _follow_presence(self, *alive_exprs: str) -> None:
        """Have `_seen` called when peers with these liveliness keys come or go, and `_linked` when the router does."""
        for key_expr in alive_exprs:
            self._start(self._watch_alive(key_expr), f"alive {key_expr}")
        self._start(self._watch_link(), "link")

    def _every(self, seconds: float, do: Callable[[], Awaitable[None] | None], name: str) -> None:
        """Do it again and again, the first time after so many seconds."""
        self._start(self._repeat(seconds, do), name)

    def _tell_status(self, key: str, status: Callable[[], Message]) -> None:
        """Show the status at once and then every second, and touch the heartbeat each time."""
        self._start(tell_status(self.bus, key, status), "status")

    async def _watch(self, key_expr: str) -> None:
        async for received in self.bus.watch(key_expr):
            self._heard(received)

    async def _watch_alive(self, key_expr: str) -> None:
        async for token in self.bus.watch_alive(key_expr):
            self._seen(*keys.owner(token.key), token.alive)

    async def _watch_link(self) -> None:
        async for link in self.bus.watch_link():
            self._linked(link.up)

    async def _repeat(self, seconds: float, do: Callable[[], Awaitable[None] | None]) -> None:
        while True:
            await asyncio.sleep(seconds)
            done = do()
            if done is not None:
                await done


class _Stopped(Exception):
    """Ends a service's task group."""


async def living(bus: Bus, key: str, timeout_s: float) -> list[Message]:
    """What others have latched under the key: only the living answer. Empty, with a warning, when none can tell."""
    try:
        answers = await bus.get(key, timeout_s=timeout_s)
    except PeerError as error:
        log.warning("cannot tell whether somebody has this name", extra={"key": key, "reason": error})
        return []
    return [answer.message for answer in answers]


async def tell_status(bus: Bus, key: str, status: Callable[[], Message]) -> None:
    """Show a service's status at once and then every second, and touch the heartbeat each time."""
    while True:
        await bus.latch(key, status())
        beat()
        await asyncio.sleep(STATUS_S)


async def open_bus(fleet: Fleet, name: str, role: str) -> Bus:
    """A session with the fleet's router. Raises RouterUnreachable."""
    config = fleet.bus
    return await Bus.open(config.endpoint, name=name, role=role, root=config.root, timeout_s=config.timeout_s)


def arguments(program: str, description: str) -> argparse.ArgumentParser:
    """A parser with the arguments that all services share."""
    parser = argparse.ArgumentParser(prog=f"python -m services.{program}", description=description)
    parser.add_argument("--config", type=Path, metavar="FLEET.toml", help="fleet file (default: built-in defaults)")
    parser.add_argument("--endpoint", help=f"router, e.g. tcp/127.0.0.1:7447 (default: ${ENDPOINT}, then the file's)")
    parser.add_argument("--log-format", choices=("kv", "json"), default="kv")
    parser.add_argument("--log-level", choices=("debug", "info", "warning", "error"), default="info")
    return parser


def load_fleet(args: argparse.Namespace) -> Fleet:
    """The fleet file with the endpoint that the command line or the environment names. Raises ConfigError."""
    fleet = load(args.config)
    endpoint = args.endpoint or os.environ.get(ENDPOINT) or fleet.bus.endpoint
    return fleet.model_copy(update={"bus": fleet.bus.model_copy(update={"endpoint": endpoint})})


def run(
    main: Callable[[asyncio.Event], Awaitable[None]],
    service: str,
    log_format: LogFormat = "kv",
    log_level: str = "info",
) -> int:
    """Run `main(stop)` to its end and return the exit code; `stop` is set when the service shall come to it.

    It is set by SIGTERM, SIGINT (a second one breaks off) and the parent's death. A UsageError out of `main`, also
    one out of a task group, is shown without traceback.
    """
    setup_logging(service, log_format, log_level.upper())
    forget_start()
    try:
        asyncio.run(_with_stop(main))
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except Exception as error:
        leaves = list(_leaves(error))
        if not all(isinstance(leaf, UsageError) for leaf in leaves):
            log.exception("failed")
            return 1
        for leaf in leaves:
            print(f"{service}: {leaf}", file=sys.stderr)
        return 2
    return 0


def forget_start() -> None:
    """Leave what the start has loaded out of garbage collection: to look through it stops everything for 0.1 s."""
    gc.collect()
    gc.freeze()


async def until_stopped(work: Coroutine[Any, Any, None], stop: asyncio.Event) -> bool:
    """Do `work`, unless `stop` is set before it is done: then break it off and return True."""
    working, stopping = asyncio.create_task(work), asyncio.create_task(stop.wait())
    try:
        await asyncio.wait((working, stopping), return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            working.result()
        return not working.done()
    finally:
        working.cancel()
        stopping.cancel()
        await asyncio.gather(working, stopping, return_exceptions=True)


async def _with_stop(main: Callable[[asyncio.Event], Awaitable[None]]) -> None:
    loop, stop = asyncio.get_running_loop(), asyncio.Event()

    def asked(number: signal.Signals) -> None:
        log.info("stopping", extra={"signal": number.name})
        stop.set()
        loop.remove_signal_handler(number)  # so that a second one works as by default

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, asked, number)

    def orphaned() -> None:
        log.warning("stopping: the parent process is gone")
        with contextlib.suppress(RuntimeError):  # the loop has closed: we are on the way out already
            loop.call_soon_threadsafe(stop.set)

    watch_parent(orphaned)
    await main(stop)


def _leaves(error: BaseException) -> Iterator[BaseException]:
    if isinstance(error, BaseExceptionGroup):
        for inner in error.exceptions:
            yield from _leaves(inner)
    else:
        yield error
