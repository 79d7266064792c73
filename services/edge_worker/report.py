"""The edge's status: load, queues, stage times, drops and the last problems."""

from __future__ import annotations

import os
from collections import deque
from typing import TYPE_CHECKING

from common.telemetry import process_stats
from common.wire import EdgeStatus, InstanceStatus
from common.wire.edge import VANISHED
from services.edge_worker.instance import Phase

if TYPE_CHECKING:
    from services.edge_worker.service import EdgeWorker

PROBLEMS = 16


class Report:
    def __init__(self, edge: EdgeWorker) -> None:
        self._edge = edge
        self._problems: deque[str] = deque(maxlen=PROBLEMS)

    def problem(self, text: str) -> None:
        """Keep a refusal to be shown, with its sender."""
        self._problems.append(text[:500])

    def status(self) -> EdgeStatus:
        edge, state, bus = self._edge, self._edge.state, self._edge.bus
        used = process_stats(edge.worker_pids())
        instances = tuple(
            InstanceStatus(
                robot=robot,
                state=VANISHED if each.given_up and each.phase is Phase.FINAL else each.phase.value,
                processed=each.processed,
                pending=len(each.backlog.waiting) + len(each.in_flight),
                worker=each.worker,
                scan_ms=1e3 * edge.maps.scan_s.get(robot, 0.0),
                gaps=each.backlog.gaps,
                skipped=each.skipped,
            )
            for robot, each in sorted(state.instances.items())
        )
        counters = {
            **state.counters,
            "frames dropped by the bus": edge.dropped(),
            "frames too early": sum(each.backlog.overrun for each in state.instances.values()),
            "frames of another stream": sum(each.foreign for each in state.instances.values()),
            "messages refused": bus.counters.refused.total(),
            "fusion failures": edge.fusion.failures,
        }
        return EdgeStatus(
            edge=edge.edge,
            cores=os.cpu_count() or 1,
            cpu_s=used.cpu_s,
            rss_mb=used.rss_mb,
            instances=instances,
            fusing=tuple(sorted(edge.fusion.state.members)),
            stages=edge.fusion.stages,
            counters=counters,
            bytes_in=bus.counters.received_bytes,
            bytes_out=bus.counters.sent_bytes,
            links=edge.links.statuses(),
            problems=(*bus.problems, *self._problems)[-PROBLEMS:],
        )
