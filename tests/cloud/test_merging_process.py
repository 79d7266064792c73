"""What the merging process is told; and when it dies, nothing that it had begun is taken for a result."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from cloud_samples import settled

from common.bus import Bus, keys
from common.bus.intake import Received
from common.config import Fleet
from common.wire import Message, RobotProfile, TrajectoryPage
from services.cloud_merger.service import CloudMerger

OpenBus = Callable[..., Awaitable[Bus]]
HOST = "tests.cloud.forgetful_host:ForgetfulHost"


class Edges:
    """Tell trajectories once `answer` is set."""

    def __init__(self) -> None:
        self.asked, self.answer = asyncio.Event(), asyncio.Event()

    async def trajectory(self, key: str, params: Mapping[str, str]) -> Message:
        self.asked.set()
        await self.answer.wait()
        return TrajectoryPage(robot=key.split("/")[3], version=1, poses=np.zeros((1, 4)))


@pytest.fixture
async def cloud(open_bus: OpenBus, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[CloudMerger]:
    """It does nothing by itself."""
    monkeypatch.setattr("services.cloud_merger.service.TARGET", HOST)
    stop = asyncio.Event()
    cloud = CloudMerger(Fleet(cloud={"merge_every_s": 1e6}), await open_bus("cloud"), stop)
    running = asyncio.create_task(cloud.run())
    async with asyncio.timeout(60):
        while not cloud._process.warm:
            await asyncio.to_thread(os.sched_yield)
    yield cloud
    stop.set()
    await running


async def kill(cloud: CloudMerger) -> None:
    """Returns once it has been noticed."""
    (pid,) = cloud._process.pids()
    os.kill(pid, signal.SIGKILL)
    async with asyncio.timeout(60):
        while cloud._process.pids() == [pid]:
            await asyncio.to_thread(os.sched_yield)
            await cloud._tick()


async def test_a_final_world_that_died_with_its_process_is_not_taken_uncorrected(
    cloud: CloudMerger, open_bus: OpenBus
) -> None:
    edges, other = Edges(), await open_bus("edges")
    for edge in ("e1", "e2"):
        await other.serve(keys.edge_trajectory(edge, keys.ANY), edges.trajectory)
    cloud.state, step = settled()
    solving = asyncio.create_task(cloud._guarded(cloud._solve(step)))
    async with asyncio.timeout(60):
        await edges.asked.wait()
        await kill(cloud)
        edges.answer.set()
        await solving
    assert cloud.state.world is None
    assert await other.get(keys.CLOUD_TRANSFORMS) == []


async def test_a_process_that_cannot_be_started_is_tried_again(
    cloud: CloudMerger, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = sys.executable
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    await kill(cloud)
    assert cloud._process.pids() == []
    assert any("/nowhere/python" in problem for problem in cloud.status().problems)
    monkeypatch.setattr(sys, "executable", python)
    await cloud._tick()
    assert len(cloud._process.pids()) == 1


async def test_a_robot_that_begins_anew_without_a_start_pose_has_none(cloud: CloudMerger) -> None:
    _, final = settled()
    told = []
    for start in ((1.0, 2.0, 0.5), None):
        profile = RobotProfile(robot="r1", stream="a" * 32, start=start)
        cloud._heard(Received(keys.robot_profile("r1"), profile, 0))
        await cloud._solve(replace(final, final=False))
        told.append(await cloud._call("told"))
    assert told == [{"r1": [1.0, 2.0, 0.5]}, {}]
