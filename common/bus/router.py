"""A Zenoh router inside a Python process. Its routing runs in Rust threads and needs nothing of the event loop."""

from __future__ import annotations

import asyncio
import json
import os
import time
from types import TracebackType

import zenoh

from common.bus.settings import router_config, said
from common.errors import UsageError

RUNTIME = "(rx: (worker_threads: 8))"
"""Routing a blocking message to a slow reader holds one of Zenoh's receiving threads, two by default: with both held,
nothing moves, not even in other sessions of the same process, which share them."""


class Router:
    """An open router; close it on every path out (`async with await Router.open()`)."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self.endpoint = endpoint
        """where it really listens, to be passed to `Bus.open`"""

    @classmethod
    async def open(cls, listen: str = "tcp/127.0.0.1:0", *, name: str = "recslam-router") -> Router:
        """Listen on `listen`; port 0 takes a free one. Raises UsageError when it cannot listen there.

        Best the first use of Zenoh in its process, which settles the number of threads for all.
        """
        os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
        try:
            session = await asyncio.to_thread(zenoh.open, router_config(listen, name=name))
        except zenoh.ZError as error:
            raise UsageError(f"cannot listen on {listen}: {said(error)}; choose a free address or port 0") from error
        return cls(session, await asyncio.to_thread(_locator, session))

    async def close(self) -> None:
        await asyncio.to_thread(self._session.close)

    async def __aenter__(self) -> Router:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()


def _locator(session: zenoh.Session) -> str:
    """The first address that the router listens on, as its admin space tells, which may be up a little later."""
    for _ in range(100):
        for reply in session.get(f"@/{session.zid()}/router"):
            locators = json.loads(reply.ok.payload.to_bytes())["locators"] if reply.ok is not None else []
            if locators:
                return str(locators[0])
        time.sleep(0.05)
    session.close()
    raise UsageError("the router's admin space does not tell its address; use a fixed port instead of 0")
