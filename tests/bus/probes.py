"""What the tests of the bus have in common."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
from collections.abc import Awaitable, Callable

from common.bus import Bus, Received, Stream
from common.wire import Claims, Frame, Message, Refusal, Routes, encode

OpenBus = Callable[..., Awaitable[Bus]]
"""the fixture `open_bus`"""
Process = subprocess.Popen[str]
Start = Callable[..., tuple[Process, str]]
"""the fixture `start`"""

STREAM = "0" * 32


def routes(n: int) -> Routes:
    return Routes(epoch=(1, n), routes={})


def claims(edge: str, n: int) -> Claims:
    return Claims(edge=edge, claims={}, epoch=(1, n))


def number(received: Received) -> int:
    assert isinstance(received.message, Routes | Claims)
    return received.message.epoch[1]


def frame(robot: str, seq: int, size: int = 0) -> Frame:
    return Frame(robot=robot, stream=STREAM, seq=seq, stamp=float(seq), kind="test", data=b"x" * size)


async def hear(sender: Bus, key: str, message: Message, stream: Stream[Received]) -> None:
    """Put the message until the stream yields it, skipping all else: a subscription takes a moment to become known,
    and a full link drops."""
    wanted = encode(message)
    while True:
        sender.put(key, message)
        with contextlib.suppress(TimeoutError):
            while encode((await asyncio.wait_for(anext(stream), 0.05)).message) != wanted:
                pass
            return


async def introduce(sender: Bus, key: str, stream: Stream[Received]) -> None:
    """Make sure that the stream hears what `sender` puts on `key`."""
    await hear(sender, key, Refusal(reason="probe"), stream)


async def real(stream: Stream[Received]) -> Received:
    """The next message that is no probe."""
    async for received in stream:
        if not isinstance(received.message, Refusal):
            return received
    raise AssertionError("the stream ended")


def freeze(process: Process) -> None:
    """Stop a process, and return when all its threads have: until then they go on answering."""
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)
