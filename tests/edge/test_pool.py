"""Promises of the pool of SLAM workers, whatever dies and whatever a kernel does."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest

from services.edge_worker.pool import Pool

TARGETS = ["tests.edge.stubborn_host:StubbornHost", "tests.edge.stubborn_host:ThreadedHost"]


@pytest.mark.parametrize("target", TARGETS, ids=["forked", "a kernel with threads"])
async def test_a_dead_worker_is_replaced_and_others_go_on(target: str) -> None:
    deaths: asyncio.Queue[int] = asyncio.Queue()
    pool = Pool(2, "graph", 20.0, lambda number, _: deaths.put_nowait(number), target)
    await pool.open()
    try:
        one, two = pool.pids()
        os.kill(one, signal.SIGKILL)
        async with asyncio.timeout(60):
            assert await deaths.get() == 0
        assert await pool.call(0, "process", robot="r1", data="scan") == "scan"
        assert pool.pids()[1] == two
        assert one not in pool.pids()
    finally:
        await pool.close()


async def test_workers_are_replaced_also_when_their_template_has_died_with_them() -> None:
    deaths: asyncio.Queue[int] = asyncio.Queue()
    pool = Pool(2, "graph", 20.0, lambda number, _: deaths.put_nowait(number), TARGETS[0])
    await pool.open()
    try:
        assert pool._template is not None
        for pid in (pool._template.process.pid, *pool.pids()):
            os.kill(pid, signal.SIGKILL)
        async with asyncio.timeout(60):
            assert {await deaths.get(), await deaths.get()} == {0, 1}
        for number in (0, 1):
            assert await pool.call(number, "process", robot="r1", data="scan") == "scan"
    finally:
        await pool.close()
