"""What an operator sees while a cluster works: a table that stays in place on a terminal, plain lines elsewhere."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from rich.console import Console
from rich.live import Live
from rich.table import Table

from common.bus import Bus, keys
from common.grid.versions import count_of
from common.wire import EdgeStatus, GlobalMapNotice, RobotStatus, Route, Routes
from services.command.collect import vanished

REDRAW_S = 0.5
LINE_S = 5.0
"""between two plain lines"""


@dataclass
class Progress:
    """The state of a run as it is known from public keys."""

    started: float = field(default_factory=time.monotonic)
    robots: dict[str, RobotStatus] = field(default_factory=dict)
    edges: dict[str, EdgeStatus] = field(default_factory=dict)
    routes: dict[str, Route] = field(default_factory=dict)
    map: GlobalMapNotice | None = None

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self.started

    def line(self) -> str:
        sent = sum(status.sent for status in self.robots.values())
        processed = sum(status.processed + 1 for status in self.robots.values())
        ended = sum(status.ended for status in self.robots.values())
        gone = "".join(f", {name} vanished" for name in vanished(self.edges, self.routes))
        return (
            f"{self.elapsed_s:6.1f} s  {len(self.robots)} robots, {ended} at their end{gone}; "
            f"{processed} of {sent} frames processed; {self._map()}"
        )

    def table(self) -> Table:
        table = Table("robot", "edge", "frames", "processed", "", title=f"{self.elapsed_s:.0f} s, {self._map()}")
        for column in table.columns[2:4]:
            column.justify = "right"
        gone = vanished(self.edges, self.routes)
        for name, status in sorted(self.robots.items()):
            state = "vanished" if name in gone else "ended" if status.ended else "driving"
            table.add_row(name, status.edge or "-", str(status.sent), str(status.processed + 1), state)
        return table

    def _map(self) -> str:
        if self.map is None:
            return "no map yet"
        count = len(self.map.components)
        final = "final map" if self.map.final else f"map {count_of(self.map.version)}"
        return f"{final} of {len(self.map.covers)} robots in {count} component{'' if count == 1 else 's'}"


@asynccontextmanager
async def shown(bus: Bus, console: Console) -> AsyncIterator[Progress]:
    """Follow the run and show it until the context is left."""
    progress = Progress()
    tasks = [
        asyncio.create_task(_follow_robots(bus, progress), name="follow robots"),
        asyncio.create_task(_follow_edges(bus, progress), name="follow edges"),
        asyncio.create_task(_follow_routes(bus, progress), name="follow routes"),
        asyncio.create_task(_follow_map(bus, progress), name="follow map"),
        asyncio.create_task((_redraw if console.is_terminal else _print)(progress, console), name="show"),
    ]
    try:
        yield progress
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _follow_robots(bus: Bus, progress: Progress) -> None:
    async for received in bus.watch(keys.robot_status(keys.ANY)):
        if isinstance(received.message, RobotStatus):
            progress.robots[received.message.robot] = received.message


async def _follow_edges(bus: Bus, progress: Progress) -> None:
    async for received in bus.watch(keys.edge_status(keys.ANY)):
        if isinstance(received.message, EdgeStatus):
            progress.edges[received.message.edge] = received.message


async def _follow_routes(bus: Bus, progress: Progress) -> None:
    async for received in bus.watch(keys.SCHEDULER_ROUTES):
        if isinstance(received.message, Routes):
            progress.routes = dict(received.message.routes)


async def _follow_map(bus: Bus, progress: Progress) -> None:
    async for received in bus.watch(keys.CLOUD_MAP):
        if isinstance(received.message, GlobalMapNotice):
            progress.map = received.message


async def _redraw(progress: Progress, console: Console) -> None:
    with Live(progress.table(), console=console, transient=True, auto_refresh=False) as live:
        while True:
            await asyncio.sleep(REDRAW_S)
            live.update(progress.table(), refresh=True)


async def _print(progress: Progress, console: Console) -> None:
    while True:
        await asyncio.sleep(LINE_S)
        console.print(progress.line(), highlight=False, soft_wrap=True)
