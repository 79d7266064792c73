"""A router for each test module, a root of its own for each test, and buses that are closed whatever happens."""

from __future__ import annotations

import signal
import subprocess
import sys
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator

import pytest

from common.bus import Bus

# Started in the background of a shell, all processes below would ignore the Ctrl-C that tests send them.
signal.signal(signal.SIGINT, signal.default_int_handler)

OpenBus = Callable[..., Awaitable[Bus]]

ROUTER = """
import asyncio, sys
from common.bus import Router

async def main():
    async with await Router.open() as router:
        print(router.endpoint, flush=True)
        await asyncio.to_thread(sys.stdin.read)

asyncio.run(main())
"""


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Where a router listens that is a process of its own, as in a real cluster."""
    command = [sys.executable, "-c", ROUTER]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.kill()


@pytest.fixture
def root() -> str:
    """First chunks of all keys of one test: tests that share a router do not hear each other."""
    return f"test/{uuid.uuid4().hex}"


@pytest.fixture
async def open_bus(endpoint: str, root: str) -> AsyncIterator[OpenBus]:
    """`await open_bus("name", ...)`: a bus on the module's router under the test's root."""
    buses: list[Bus] = []

    async def open_one(name: str = "test", **settings: object) -> Bus:
        settings = {"endpoint": endpoint, "root": root, "role": "test", **settings}
        buses.append(await Bus.open(name=name, **settings))  # type: ignore[arg-type]
        return buses[-1]

    yield open_one
    for bus in buses:
        await bus.close()
