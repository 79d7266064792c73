"""Measuring links over which nothing comes: now and then a few bytes of each robot in reach that runs elsewhere.

Without it nobody knows how fast a robot's frames would come to the edges that do not run it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from common.bus import Bus, keys
from common.errors import PeerError
from common.link import LinkMeter
from common.wire import FramePage
from services.edge_worker.state import EdgeState

LOOK_S = 1.0
SIZES = (1024, 65_536)
"""bytes of the two answers of a probe: what they differ by tells speed from delay"""

log = logging.getLogger(__name__)


@dataclass
class Idle:
    """Which link has been idle for longest; nothing is due that was measured within `every_s`."""

    every_s: float
    seen: dict[str, tuple[int, float]] = field(default_factory=dict)
    """robot → pages taken from it, and when that last changed"""

    def due(self, robots: Iterable[str], taken: Mapping[str, int], now: float) -> str | None:
        """`taken`: robot → pages taken from it so far; `now`: s of any clock."""
        waits = {}
        for robot in robots:
            pages, since = self.seen.get(robot, (-1, now))
            if pages != taken.get(robot, 0):
                self.seen[robot] = taken.get(robot, 0), now
            elif now - since >= self.every_s:
                waits[robot] = since
        longest = min(waits, key=lambda robot: (waits[robot], robot), default=None)
        if longest is not None:
            self.seen[longest] = taken.get(longest, 0), now  # also when it does not answer
        return longest


class Probes:
    """Ask robots, one at a time, for bytes that mean nothing."""

    def __init__(self, edge: str, bus: Bus, state: EdgeState, links: LinkMeter, every_s: float) -> None:
        self._edge, self._bus, self._state, self._links = edge, bus, state, links
        self._idle = Idle(every_s)

    async def run(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            robot = self._idle.due(self._in_reach(), self._links.taken("robot/"), time.monotonic())
            if robot is not None:
                await self._probe(robot)

    def _in_reach(self) -> list[str]:
        """Robots that may come here one day."""
        profiles = self._state.profiles.values()
        reached = [each.robot for each in profiles if each.edges is None or self._edge in each.edges]
        return [robot for robot in reached if robot not in self._state.ends]

    async def _probe(self, robot: str) -> None:
        for size in SIZES:
            begin = time.monotonic()
            try:
                answers = await self._bus.get(keys.robot_backfill(robot), {"probe": size})
            except PeerError as error:
                log.debug("probe failed", extra={"robot": robot, "reason": error})
                return
            if answers and isinstance(answers[0].message, FramePage):
                self._links.took(f"robot/{robot}", size, time.monotonic() - begin)
