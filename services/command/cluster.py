"""A whole cluster out of one command: the router in this process, every service as a child, results at the end."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from common.bus import Bus, Router, keys
from common.config import Fleet
from common.errors import PeerError, UsageError
from common.wire import GlobalMapNotice
from services.command import accuracy, collect, fleets, report, results
from services.command.children import Children
from services.command.progress import Progress, shown
from services.command.run_folder import Cluster, RunFolder
from services.command.topology import arrange, programs

Spare = Callable[[str, str], bool]
"""(program, how it ended) → whether the others go on without it"""


class Made(NamedTuple):
    map: collect.GlobalMap
    statuses: collect.Statuses
    elapsed_s: float
    """wall time from the fleet's start to this map"""


async def run(
    fleet: Fleet, out: Path | None, console: Console, *, truth: Fleet | None = None, keep: bool = False
) -> int:
    """Run the fleet, leave results in its folder and return the exit code.

    A batch fleet ends with its final map (`keep`: it stays up then until it is asked to stop). A live one runs until
    SIGINT or SIGTERM; both leave the last map. `truth` is the fleet whose simulation a recording came from. Returns 0,
    or 128 + the signal's number when a batch run was broken off. Raises ServiceDied when a service ended by itself,
    and UsageError when robots would go on with the frames of another fleet.
    """
    fleet = arrange(fleet)
    folder = RunFolder.make(out)
    if folder.spooled and not fleets.same_frames(fleet, folder.config):
        raise UsageError(f"{folder.spool}: has frames of another fleet; remove it, or choose another --out")
    fleets.write(fleet, folder.config)
    made: Made | None = None
    with _asked_to_stop() as asked:
        async with _up(fleet, folder, console) as (bus, children):
            async with shown(bus, console) as progress:
                spare = _robots_on_their_way(fleet, progress, console)
                finished = await _until_end(fleet, bus, children, asked, spare)
            if finished:
                made = await _collected(bus, progress.elapsed_s)
            elif not fleet.batch:
                made = await _collected_live(bus, progress.elapsed_s, console)
            if finished and keep:
                await _leave(made, fleet, truth, folder, console)
                console.print(f"the cluster stays up at {bus.endpoint}; Ctrl-C stops it", soft_wrap=True)
                await _first(asked, children.watch(spare))
        if not keep:
            await _leave(made, fleet, truth, folder, console)
    if finished and not fleet.robot.record:
        shutil.rmtree(folder.spool, ignore_errors=True)
    return 0 if finished or not fleet.batch else 128 + asked.result()


@asynccontextmanager
async def _up(fleet: Fleet, folder: RunFolder, console: Console) -> AsyncIterator[tuple[Bus, Children]]:
    """Router, bus and all services; leaving it stops them."""
    async with await Router.open() as router:
        bus_config = fleet.bus
        async with await Bus.open(router.endpoint, name="command", role="command", root=bus_config.root) as bus:
            folder.announce(Cluster(router.endpoint, bus_config.root, fleet.name, os.getpid(), time.time()))
            try:
                async with Children(folder, router.endpoint) as children:
                    console.print(f"{fleet.name}: {_counted(fleet)}; results in {folder.path}", soft_wrap=True)
                    yield bus, children
            finally:
                folder.withdraw()


def _robots_on_their_way(fleet: Fleet, progress: Progress, console: Console) -> Spare:
    """A robot that is killed after it was routed does not end the run: its map has what had come of it."""

    def spare(name: str, how: str) -> bool:
        tier, _, robot = name.partition("/")
        if tier != "robot" or robot not in progress.routes:
            return False
        wait = f"after edge.lease_s = {fleet.edge.lease_s:g} s its map is final as it is"
        console.print(f"{robot} {how}; {wait}", highlight=False, soft_wrap=True)
        return True

    return spare


async def _until_end(fleet: Fleet, bus: Bus, children: Children, asked: asyncio.Future[int], spare: Spare) -> bool:
    """Start everything and wait; True when the final map has come."""
    folder = children.folder

    async def go() -> None:
        async with asyncio.TaskGroup() as tasks:
            for program in programs(fleet, folder.spool):
                if program.delay_s:
                    tasks.create_task(children.start(program), name=program.name)
                else:
                    await children.start(program)
            await _final_map(bus, fleet)

    return await _first(asked, _all_or_died(go(), children, spare))


async def _all_or_died(work: Coroutine[Any, Any, object], children: Children, spare: Spare) -> None:
    """`work` to its end, unless a child ends before that is not spared."""
    working, watching = asyncio.create_task(work), asyncio.create_task(children.watch(spare))
    try:
        done, _ = await asyncio.wait({working, watching}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in (working, watching):
            task.cancel()
        await asyncio.gather(working, watching, return_exceptions=True)


async def _first(asked: asyncio.Future[int], work: Coroutine[Any, Any, object]) -> bool:
    """True when `work` ended before somebody asked to stop."""
    working = asyncio.create_task(work)
    try:
        await asyncio.wait((asked, working), return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            working.result()
        return working.done()
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)


async def _final_map(bus: Bus, fleet: Fleet) -> None:
    """Return when a batch fleet's final map with all its robots is there; never for a live fleet."""
    robots = {entry.id for entry in fleet.robots}
    async for received in bus.watch(keys.CLOUD_MAP):
        notice = received.message
        if fleet.batch and isinstance(notice, GlobalMapNotice) and notice.final and robots <= set(notice.covers):
            return


async def _collected(bus: Bus, elapsed_s: float) -> Made:
    return Made(await collect.global_map(bus), await collect.statuses(bus), elapsed_s)


async def _collected_live(bus: Bus, elapsed_s: float, console: Console) -> Made | None:
    """None, and the reason told, when there is no map: a live fleet may be stopped before its first."""
    try:
        return await _collected(bus, elapsed_s)
    except PeerError as error:
        console.print(f"no map to leave: {error}", soft_wrap=True)
        return None


async def _leave(made: Made | None, fleet: Fleet, truth: Fleet | None, folder: RunFolder, console: Console) -> None:
    """Write results and report, and say what is in them."""
    if made is None:
        return
    files = results.write_results(made.map, folder.path)
    final = made.map.notice.final  # a map that is not done is not to be measured by what will be seen
    scored = await asyncio.to_thread(accuracy.score, made.map, truth or fleet) if final else None
    data = report.report(fleet, made.map, made.statuses, scored, made.elapsed_s)
    report.write_report(data, folder.path)
    for line in report.summary(data):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"files      {folder.path}: {', '.join([*files, 'report.md'])}", soft_wrap=True)


@contextmanager
def _asked_to_stop() -> Iterator[asyncio.Future[int]]:
    """Done, with the signal's number, at the first SIGINT or SIGTERM; a second one breaks off."""
    loop = asyncio.get_running_loop()
    asked: asyncio.Future[int] = loop.create_future()

    def ask(number: signal.Signals) -> None:
        loop.remove_signal_handler(number)
        if not asked.done():
            asked.set_result(int(number))

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ask, number)
    try:
        yield asked
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


def _counted(fleet: Fleet) -> str:
    return f"{len(fleet.robots)} robots, {len(fleet.edges)} edges, topology {fleet.topology}"
