"""The edge's status: load, queues, stage times, drops and the last problems."""

from __future__ import annotations

import os
from collections import deque

from common.bus import Bus
from common.link import LinkMeter
from common.telemetry import process_stats
from common.wire import EdgeStatus, InstanceStatus
from common.wire.edge import VANISHED
from services.edge_worker.fusion import Fusion
from services.edge_worker.phase import Phase
from services.edge_worker.pool import Pool
from services.edge_worker.robot_maps import RobotMaps
from services.edge_worker.state import EdgeState

PROBLEMS = 16


class Report:
    def __init__(
        self, state: EdgeState, pool: Pool, fusion: Fusion, maps: RobotMaps, bus: Bus, links: LinkMeter
    ) -> None:
        self._state, self._pool, self._fusion, self._maps = state, pool, fusion, maps
        self._bus, self._links = bus, links
        self._problems: deque[str] = deque(maxlen=PROBLEMS)

    def problem(self, text: str) -> None:
        """Keep a refusal to be shown, with its sender."""
        self._problems.append(text[:500])

    def status(self, dropped: int) -> EdgeStatus:
        """`dropped` are the frames that came faster than they were taken."""
        state, fusion, bus = self._state, self._fusion, self._bus
        used = process_stats([*self._pool.pids(), *fusion.pids()])
        instances = tuple(
            InstanceStatus(
                robot=robot,
                state=VANISHED if each.given_up and each.phase is Phase.FINAL else each.phase.value,
                processed=each.processed,
                pending=len(each.backlog.waiting) + len(each.in_flight),
                worker=each.worker,
                scan_ms=1e3 * self._maps.scan_s.get(robot, 0.0),
                gaps=each.backlog.gaps,
                skipped=each.skipped,
            )
            for robot, each in sorted(state.instances.items())
        )
        counters = {
            **state.counts(),
            "frames dropped by the bus": dropped,
            "messages refused": bus.counters.refused.total(),
            "fusion failures": fusion.failures,
        }
        return EdgeStatus(
            edge=state.edge,
            cores=os.cpu_count() or 1,
            cpu_s=used.cpu_s,
            rss_mb=used.rss_mb,
            instances=instances,
            fusing=tuple(sorted(fusion.state.members)),
            stages=fusion.stages,
            counters=counters,
            bytes_in=bus.counters.received_bytes,
            bytes_out=bus.counters.sent_bytes,
            links=self._links.statuses(),
            problems=(*bus.problems, *self._problems, *fusion.problems())[-PROBLEMS:],
        )
