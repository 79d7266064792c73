"""Promises of the pool of SLAM workers, whatever dies and whatever a kernel does."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest
from edge_samples import watched

from services.edge_worker.pool import Pool

TARGETS = ["tests.edge.stubborn_host:StubbornHost", "tests.edge.stubborn_host:ThreadedHost"]


@pytest.mark.parametrize("target", TARGETS, ids=["forked", "a kernel with threads"])
async def test_a_dead_worker_is_replaced_and_others_go_on(target: str) -> None:
    deaths: asyncio.Queue[int] = asyncio.Queue()
    pool = Pool(2, "graph", 20.0, lambda number, _: deaths.put_nowait(number), target)
    async with watched(pool):
        one, two = pool.pids()
        os.kill(one, signal.SIGKILL)
        async with asyncio.timeout(60):
            assert await deaths.get() == 0
        assert await pool.call(0, "process", robot="r1", data="scan") == "scan"
        assert pool.pids()[1] == two
        assert one not in pool.pids()


async def test_workers_are_replaced_also_when_their_template_has_died_with_them() -> None:
    deaths: asyncio.Queue[int] = asyncio.Queue()
    pool = Pool(2, "graph", 20.0, lambda number, _: deaths.put_nowait(number), TARGETS[0])
    async with watched(pool):
        assert pool._template is not None
        for pid in (pool._template.process.pid, *pool.pids()):
            os.kill(pid, signal.SIGKILL)
        async with asyncio.timeout(60):
            assert {await deaths.get(), await deaths.get()} == {0, 1}
        for number in (0, 1):
            assert await pool.call(number, "process", robot="r1", data="scan") == "scan"


async def test_what_fails_as_a_death_is_told_ends_the_watch_and_not_in_silence() -> None:
    def on_death(number: int, how: str) -> None:
        raise ValueError(f"worker {number} {how}")

    pool = Pool(1, "graph", 20.0, on_death, TARGETS[0])
    await pool.open()
    try:
        os.kill(pool.pids()[0], signal.SIGKILL)
        with pytest.raises(ExceptionGroup) as raised:
            await asyncio.wait_for(pool.watch(), 60)
        assert "worker 0 ended with code -9" in str(raised.value.exceptions)
    finally:
        await pool.close()
