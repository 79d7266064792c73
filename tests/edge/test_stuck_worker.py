"""A SLAM worker that is stuck on a scan is replaced; one that only waits for its turn is not."""

from __future__ import annotations

import asyncio

import pytest
from edge_samples import watched

from common.errors import WorkerDied
from services.edge_worker.patience import Activity, Patience
from services.edge_worker.pool import Pool

TARGET = "tests.edge.stubborn_host:StubbornHost"


@pytest.mark.parametrize("how", ["spin", "sleep"])
async def test_a_worker_stuck_on_a_scan_is_replaced_and_others_go_on(how: str) -> None:
    deaths: asyncio.Queue[tuple[int, str]] = asyncio.Queue()
    pool = Pool(2, "graph", 0.4, lambda number, why: deaths.put_nowait((number, why)), TARGET)
    async with watched(pool):
        stuck = asyncio.create_task(pool.call(0, "process", robot="r1", data=how))
        behind = asyncio.create_task(pool.call(0, "process", robot="r2", data="scan"))
        await pool.call(1, "finish", robot="r3")
        for _ in range(20):
            assert await pool.call(1, "process", robot="r3", data="scan") == "scan"
        async with asyncio.timeout(60):
            number, why = await deaths.get()
        assert number == 0
        assert "more than 0.4 s on one scan" in why
        for lost in (stuck, behind):
            with pytest.raises(WorkerDied):
                await lost
        assert await pool.call(0, "process", robot="r1", data="scan") == "scan"
        assert deaths.empty()


def test_time_without_a_processor_is_not_spent() -> None:
    patience = Patience(20.0)
    assert not any(patience.stuck(1, Activity(0.01 * s, False), 100.0 * s) for s in range(100))
    assert not any(patience.stuck(2, Activity(1.0, False), 1e4 + s) for s in range(100)), "runnable, and never run"


def test_many_scans_are_not_one() -> None:
    patience = Patience(20.0)
    assert not any(patience.stuck(scan // 10, Activity(float(scan), False), float(scan)) for scan in range(200))
    assert not any(patience.stuck(None, Activity(0.0, True), 300.0 + s) for s in range(100)), "nothing to do"


def test_what_computes_or_sleeps_for_longer_than_the_limit_is_stuck() -> None:
    spinning, sleeping = Patience(20.0), Patience(20.0)
    spun = [spinning.stuck(1, Activity(0.5 * s, False), float(s)) for s in range(60)]
    slept = [sleeping.stuck(1, Activity(3.0, True), float(s)) for s in range(60)]
    assert spun.index(True) == 41
    assert slept.index(True) == 21
