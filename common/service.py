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

from common.config import Fleet, load
from common.errors import UsageError
from common.parent import watch_parent
from common.telemetry import LogFormat, setup_logging

ENDPOINT = "RECSLAM_ENDPOINT"
"""environment name of the router's endpoint; goes before the fleet file, after the command line"""

log = logging.getLogger(__name__)


class Stopped(Exception):
    """Raised inside a service's task group to end all of it: `except* Stopped` follows."""


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
