"""Programs that the tests of the bus start as processes: `python bus_program.py WHAT ENDPOINT ROOT [HOW]`.

Each prints a line when it is ready and ends when its standard input is closed.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import signal
import sys

from common.bus import Bus, Router, keys
from common.wire import Route, Routes


def say(text: str) -> None:
    print(text, flush=True)


async def told_to_end() -> None:
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)


async def use_everything(bus: Bus) -> list[object]:
    """Every kind of declaration that could keep a process from ending."""
    await bus.latch(keys.SCHEDULER_ROUTES, routes(1))
    await bus.declare_alive(keys.SCHEDULER_ALIVE)

    async def nothing(key: str, params: object) -> None:
        return None

    await bus.serve(keys.robot_backfill("*"), nothing)
    streams = [bus.subscribe("**"), bus.watch("**"), bus.watch_alive("**"), bus.watch_link()]
    await anext(streams[1])
    return [*streams]


def routes(n: int, robots: int = 0) -> Routes:
    route = Route(slam_edge="e1", fuse_edge="e1", epoch=(1, n))
    return Routes(epoch=(1, n), routes={f"r{i}": route for i in range(robots)})


async def leave(endpoint: str, root: str, how: str) -> None:
    """Open, use everything, and leave in the way named."""
    if how.startswith("forget"):
        await use_everything(await Bus.open(endpoint, name="leaver", role="test", root=root))
        say("ready")
        if how == "forget-and-raise":
            raise RuntimeError("leaving")
        return
    async with await Bus.open(endpoint, name="leaver", role="test", root=root) as bus:
        streams = await use_everything(bus)
        task = asyncio.current_task()
        assert task is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
        say("ready")
        if how == "exception":
            raise RuntimeError("leaving")
        if how == "exit":
            sys.exit(3)
        if how == "signal":
            async for _ in streams[0]:  # type: ignore[attr-defined]
                pass


async def hold(endpoint: str, root: str) -> None:
    """Subscribe and watch all, take nothing, show a token, until told to end (or killed, or stopped)."""
    async with await Bus.open(endpoint, name="holder", role="test", root=root) as bus:
        streams = bus.subscribe("**"), bus.watch("**")
        await bus.declare_alive(keys.robot_alive("holder"))
        await bus.latch(keys.SCHEDULER_ROUTES, routes(7))
        say("ready")
        await told_to_end()
        del streams


async def route(endpoint: str, root: str) -> None:
    async with await Router.open(endpoint) as router:
        say(router.endpoint)
        await told_to_end()


async def child_latches(endpoint: str, root: str) -> None:
    async with await Bus.open(endpoint, name="child", role="test", root=root) as bus:
        await bus.latch(keys.SCHEDULER_ROUTES, routes(5))
        await told_to_end()


def in_child(endpoint: str, root: str) -> None:
    asyncio.run(child_latches(endpoint, root))


async def spawn(endpoint: str, root: str) -> None:
    """A parent with an open bus starts a child that opens its own."""
    async with await Bus.open(endpoint, name="parent", role="test", root=root) as bus:
        child = multiprocessing.get_context("spawn").Process(target=in_child, args=(endpoint, root))
        stream = bus.watch(keys.SCHEDULER_ROUTES)
        child.start()
        say(str((await anext(stream)).message.epoch))  # type: ignore[attr-defined]
        await asyncio.to_thread(child.join)
        say(str(child.exitcode))


if __name__ == "__main__":
    what, *arguments = sys.argv[1:]
    asyncio.run(globals()[what](*arguments))
