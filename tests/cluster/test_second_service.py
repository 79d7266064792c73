"""Of two services under one name the second is refused, for as long as the first lives."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from harness import PATIENCE_S, Cluster, cluster, fleet

from common.bus import keys
from common.wire import CloudStatus, EdgeStatus, Message, SchedulerStatus

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(240)]

SERVICES: dict[str, tuple[str, type[Message], str]] = {
    "scheduler": (keys.SCHEDULER_STATUS, SchedulerStatus, "another scheduler is there"),
    "cloud": (keys.CLOUD_STATUS, CloudStatus, "another cloud is there"),
    "edge-1": (keys.edge_status("edge-1"), EdgeStatus, "another edge/edge-1 is there"),
}


async def test_a_second_service_under_one_name_is_refused_until_the_first_has_died(tmp_path: Path) -> None:
    async with cluster(fleet(), tmp_path) as made:
        await made.start(*SERVICES)
        await begun(made)
        first = made.processes.copy()
        await made.start(*SERVICES)
        second, made.processes = made.processes, first
        async with asyncio.timeout(PATIENCE_S):
            assert [await second[name].wait() for name in SERVICES] == [2, 2, 2]
        for name, (_, _, words) in SERVICES.items():
            assert words in (tmp_path / f"{name}.log").read_text()
        assert {process.returncode for process in first.values()} == {None}
        for name in SERVICES:
            await made.kill(name)
        await made.start(*SERVICES)
        await begun(made)


async def begun(made: Cluster) -> None:
    """All have shown a status."""
    for key, kind, _ in SERVICES.values():
        await made.hear(key, kind, lambda _: True)
