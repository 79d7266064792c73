"""A router for each test module, a root of its own for each test, and buses that are closed whatever happens."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator

import pytest

from common.bus import Bus, Router

OpenBus = Callable[..., Awaitable[Bus]]


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    """A router inside this process, on a free port."""
    router = asyncio.run(Router.open())
    yield router
    asyncio.run(router.close())


@pytest.fixture
def root() -> str:
    """First chunks of all keys of one test: tests that share a router do not hear each other."""
    return f"test/{uuid.uuid4().hex}"


@pytest.fixture
async def open_bus(router: Router, root: str) -> AsyncIterator[OpenBus]:
    """`await open_bus("name", ...)`: a bus on the module's router under the test's root."""
    buses: list[Bus] = []

    async def open_one(name: str = "test", **settings: object) -> Bus:
        settings = {"endpoint": router.endpoint, "root": root, "role": "test", **settings}
        buses.append(await Bus.open(name=name, **settings))  # type: ignore[arg-type]
        return buses[-1]

    yield open_one
    for bus in buses:
        await bus.close()
