"""Edges that cannot keep up: the frames of their robots wait, more of them with every report.

How far an edge is *late* is what its robots have made and it has not processed, in seconds of their making. An edge
that builds a map anew from the spool is late, too, but ever less so. One that falls behind further is overloaded, and
whatever the policy plans, so many of its robots are run elsewhere that it can follow with the rest.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass

from common.wire import EdgeStatus
from services.scheduler.inputs import Inputs

LATE_S = 3.0
"""an edge is not overloaded before it is so late: stalls of a busy host are shorter"""
WATCH_S = 3.0
"""time over which it must have fallen behind, the same robots being run there"""
TAKING = ("running", "finishing")
"""states of an instance that takes frames"""
ROOM = 0.8
"""share of an edge's power that its robots may need"""


@dataclass(frozen=True)
class Report:
    when: float
    waiting: Mapping[str, int]
    """robot → frames made and not processed"""
    processed: int
    """frames, of all robots"""


@dataclass(frozen=True)
class Relief:
    moves: Mapping[str, str]
    """robot → edge that shall run it; empty when no edge has room"""
    reason: str


class Overloads:
    """Hears what edges report; `inputs` must have heard it before. `allowance`: frames that a robot which can wait is
    ahead of its edge by design."""

    def __init__(self, inputs: Inputs, allowance: int) -> None:
        self._inputs, self._allowance = inputs, allowance
        self._reports: dict[str, deque[Report]] = defaultdict(deque)

    def reported(self, status: EdgeStatus, now: float) -> None:
        running = [each for each in status.instances if each.state in TAKING]
        waiting = {each.robot: max(0, self._inputs.sent(each.robot) - 1 - each.processed) for each in running}
        reports = self._reports[status.edge]
        if reports and reports[-1].waiting.keys() != waiting.keys():
            reports.clear()
        reports.append(Report(now, waiting, sum(each.processed for each in running)))
        while len(reports) > 2 and now - reports[1].when >= WATCH_S:
            reports.popleft()

    def late_s(self, edge: str) -> float:
        """How far the edge is behind by its last report."""
        reports = self._reports[edge]
        return self._late(reports[-1]) if reports else 0.0

    def relief(self, edge: str, reach: Mapping[str, list[str]]) -> Relief | None:
        """Which of its robots must be run elsewhere; None when the edge is not overloaded.

        `reach`: robot → edges that are there and within its reach. Those with the shortest streams go first: their maps
        are soonest made anew.
        """
        reports = self._reports[edge]
        if not reports or not self._falls_behind(reports):
            return None
        first, last = reports[0], reports[-1]
        power = ROOM * (last.processed - first.processed) / (last.when - first.when)
        staying = sorted(last.waiting, key=lambda robot: (self._inputs.sent(robot), robot))
        said = f"{edge} cannot keep up with its robots"
        used = {other: self._use(other) for other in self._reports}
        moves: dict[str, str] = {}
        for robot in staying:
            if sum(self._inputs.frame_hz(each) for each in staying if each not in moves) <= power:
                break
            choice = {
                other: used.get(other, 0.0) + self._need(robot, other)
                for other in reach.get(robot, [])
                if other != edge and self._keeps_up(other)
            }
            best = min(choice, key=lambda other: (choice[other], other), default=None)
            if best is not None and choice[best] <= ROOM:
                moves[robot], used[best] = best, choice[best]
        reports.clear()  # what comes of it is seen over the next WATCH_S
        return Relief(moves, said if moves else f"{said}, and no other edge within their reach has room")

    def _falls_behind(self, reports: deque[Report]) -> bool:
        first, last = reports[0], reports[-1]
        if last.when - first.when < WATCH_S or last.processed <= first.processed:
            return False  # what does not move at all is no load: it starts, or is stuck and seen to elsewhere
        return self._late(last) > max(LATE_S, self._late(first))

    def _keeps_up(self, edge: str) -> bool:
        """It has not been half as late as would overload it: no edge that struggles itself is given more to do."""
        return all(self._late(report) < LATE_S / 2 for report in self._reports[edge])

    def _late(self, report: Report) -> float:
        frames = sum(max(0, count - self._allowance) for count in report.waiting.values())
        rate = sum(self._inputs.frame_hz(robot) for robot in report.waiting)
        return frames / rate if rate > 0 else 0.0

    def _use(self, edge: str) -> float:
        """Share of the edge's power that its robots need."""
        reports = self._reports[edge]
        return sum(self._need(robot, edge) for robot in reports[-1].waiting) if reports else 0.0

    def _need(self, robot: str, edge: str) -> float:
        inputs = self._inputs
        seconds = inputs.scan_s(robot, edge) / inputs.speed(edge)
        return inputs.frame_hz(robot) * seconds / inputs.cores(edge)
