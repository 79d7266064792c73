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
from common.wire import EdgeStatus, GlobalMapNotice, Message, RobotStatus, Route, Routes
from services.command.collect import vanished

FOLLOWED = (keys.robot_status(keys.ANY), keys.edge_status(keys.ANY), keys.SCHEDULER_ROUTES, keys.CLOUD_MAP)
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

    def hear(self, message: Message) -> None:
        match message:
            case RobotStatus():
                self.robots[message.robot] = message
            case EdgeStatus():
                self.edges[message.edge] = message
            case Routes():
                self.routes = dict(message.routes)
            case GlobalMapNotice():
                self.map = message

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
        *(asyncio.create_task(_follow(bus, key, progress), name=f"follow {key}") for key in FOLLOWED),
        asyncio.create_task((_redraw if console.is_terminal else _print)(progress, console), name="show"),
    ]
    try:
        yield progress
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _follow(bus: Bus, key_expr: str, progress: Progress) -> None:
    async for received in bus.watch(key_expr):
        progress.hear(received.message)


async def _redraw(progress: Progress, console: Console) -> None:
    with Live(progress.table(), console=console, transient=True, auto_refresh=False) as live:
        while True:
            await asyncio.sleep(REDRAW_S)
            live.update(progress.table(), refresh=True)


async def _print(progress: Progress, console: Console) -> None:
    while True:
        await asyncio.sleep(LINE_S)
        console.print(progress.line(), highlight=False, soft_wrap=True)
