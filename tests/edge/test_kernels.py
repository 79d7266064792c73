"""What an instance goes on from: the newest checkpoint that its kernel takes, and never one of an earlier life."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest
from edge_samples import STREAM, routes

from common.bus import Bus
from common.config import Fleet
from services.edge_worker.checkpoint import Checkpoint
from services.edge_worker.checkpoints import Kept, OnDisk
from services.edge_worker.instructions import Open
from services.edge_worker.kernels import Kernels
from services.edge_worker.pool import Pool
from services.edge_worker.state import EdgeState, Opened, Routed

OpenBus = Callable[..., Awaitable[Bus]]
NEWEST, OLDER = Kept(Checkpoint(STREAM, 20, 0, 0), b"foreign"), Kept(Checkpoint(STREAM, 10, 0, 0), b"good")


class Edge:
    """r1 is routed here, and its checkpoints lie on a disk."""

    def __init__(self, kernels: Kernels, pool: Pool, state: EdgeState, store: OnDisk, problems: list[str]) -> None:
        self.kernels, self.pool, self.state, self.store, self.problems = kernels, pool, state, store, problems
        (self.step,) = [step for step in state.handle(Routed(routes(1, {"r1": "e1"}))) if isinstance(step, Open)]

    async def lives(self) -> list[int]:
        """Of the kernels opened, in order."""
        return list(await self.pool.call(0, "opened"))


@pytest.fixture
async def edge(tmp_path: Path, open_bus: OpenBus) -> AsyncIterator[Edge]:
    pool = Pool(1, "graph", 20.0, lambda number, how: None, "tests.edge.stubborn_host:StubbornHost")
    await pool.open()
    state, problems = EdgeState("e1", 1, window=16), list[str]()
    fleet = Fleet(edge={"checkpoints": tmp_path})
    yield Edge(Kernels(fleet, state, pool, await open_bus(), problems.append), pool, state, OnDisk(tmp_path), problems)
    await pool.close()


async def test_a_checkpoint_that_the_kernel_refuses_is_told_and_the_one_before_is_taken(edge: Edge) -> None:
    for kept in (OLDER, NEWEST):
        await edge.store.keep("r1", kept)
    assert await edge.kernels.open(edge.step) == Opened("r1", 1, OLDER.checkpoint, durable=True)
    (problem,) = edge.problems
    assert "robot/r1: checkpoint at frame 20 refused" in problem


async def test_an_instance_that_was_begun_anew_is_not_replaced_by_what_its_earlier_life_asked_for(edge: Edge) -> None:
    for kept in (OLDER, NEWEST):
        await edge.store.keep("r1", kept)
    first = asyncio.create_task(edge.kernels.open(edge.step))
    while edge.pool._workers[0].at_work is None:
        await asyncio.to_thread(edge.store._files, "r1", STREAM)  # what it waits for, too
    (again,) = edge.state.instances["r1"].open()
    assert isinstance(again, Open)
    assert await first is None
    assert (await edge.kernels.open(again), await edge.lives()) == (Opened("r1", 2, OLDER.checkpoint, True), [2])


async def test_checkpoints_on_a_disk_that_does_not_answer_are_waited_for(
    edge: Edge, monkeypatch: pytest.MonkeyPatch
) -> None:
    await edge.store.keep("r1", OLDER)
    broken = asyncio.Event()
    newest = OnDisk.newest

    async def fail_once(store: OnDisk, robot: str, stream: str) -> tuple[list[Kept], list[str]]:
        if not broken.is_set():
            broken.set()
            raise OSError("stale file handle")
        return await newest(store, robot, stream)

    monkeypatch.setattr(OnDisk, "newest", fail_once)
    monkeypatch.setattr("services.edge_worker.kernels.RETRY_S", 0.0)
    assert await edge.kernels.open(edge.step) == Opened("r1", 1, OLDER.checkpoint, durable=True)
    (problem,) = edge.problems
    assert "robot/r1: edge.checkpoints: stale file handle" in problem
