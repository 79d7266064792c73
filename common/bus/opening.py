"""Opens a Zenoh session with a deadline, and sees to it that none is left behind."""

from __future__ import annotations

import asyncio
import contextlib
import threading

import zenoh

from common.bus.settings import node_config, said
from common.errors import RouterUnreachable, UsageError

ATTEMPT_S = 2.0
"""longest single attempt: Zenoh's own waiting cannot be interrupted"""
PAUSE_S = 0.1


async def open_session(endpoint: str, *, name: str, role: str, timeout_s: float) -> zenoh.Session:
    """A session with the router at `endpoint`. Raises RouterUnreachable after `timeout_s`."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout_s
    reason = "no answer"
    while (left := deadline - loop.time()) > 0:
        try:
            config = node_config(endpoint, name=name, role=role, connect_s=min(left, ATTEMPT_S))
        except zenoh.ZError as error:
            raise UsageError(f"{endpoint!r} is no endpoint: {said(error)}; write it like tcp/127.0.0.1:7447") from error
        try:
            return await _attempt(config, left)
        except zenoh.ZError as error:
            reason = said(error)
        await asyncio.sleep(max(0.0, min(PAUSE_S, deadline - loop.time())))
    raise RouterUnreachable(
        f"no router at {endpoint} within {timeout_s:g} s ({reason}); start one with `recslam up`, or set bus.endpoint"
    )


async def _attempt(config: zenoh.Config, left: float) -> zenoh.Session:
    """One attempt in a thread; a session that comes when nobody waits any more is closed again."""
    future = asyncio.get_running_loop().run_in_executor(None, zenoh.open, config)
    try:
        done, _ = await asyncio.wait({future}, timeout=left)
    except asyncio.CancelledError:
        future.add_done_callback(_close_late)
        raise
    if not done:
        future.add_done_callback(_close_late)
        raise zenoh.ZError("no answer")
    return future.result()


def _close_late(future: asyncio.Future[zenoh.Session]) -> None:
    with contextlib.suppress(zenoh.ZError, asyncio.CancelledError):
        future.result().close()


def close_with_process(session: zenoh.Session, ended: threading.Event) -> None:
    """Close a forgotten session when the main thread ends: its callback threads would keep the process for ever."""
    main = threading.main_thread()
    while main.is_alive():
        if ended.wait(0.5):
            return
    session.close()
