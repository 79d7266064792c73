from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from probes import OpenBus, frame, routes

from common.bus import keys

pytestmark = pytest.mark.timeout(60)
ZENOH = shutil.which("zenoh", path=str(Path(sys.executable).parent)) or shutil.which("zenoh")
if ZENOH is None:
    pytest.skip("zenoh-cli is not installed", allow_module_level=True)


@pytest.fixture
def root() -> str:
    return "recslam/v1"


def command(endpoint: str, *arguments: str) -> list[str]:
    return [str(ZENOH), "--mode", "client", "--connect", endpoint, *arguments, "--decoder", "recslam"]


async def test_the_zenoh_command_reads_latched_values(open_bus: OpenBus, endpoint: str) -> None:
    bus = await open_bus()
    await bus.latch(keys.SCHEDULER_ROUTES, routes(6))
    run = await asyncio.to_thread(
        subprocess.run,
        command(endpoint, "get", "-s", "recslam/v1/scheduler/routes"),
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert run.returncode == 0, run.stderr
    assert '"message": "Routes"' in run.stdout
    assert '"epoch": [1, 6]' in run.stdout


async def test_the_zenoh_command_shows_streams_as_they_go_by(open_bus: OpenBus, endpoint: str) -> None:
    bus = await open_bus()
    process = await asyncio.create_subprocess_exec(
        *command(endpoint, "subscribe", "-k", "recslam/v1/**"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    line = asyncio.create_task(process.stdout.readline())
    try:
        async with asyncio.timeout(30):
            while not line.done():
                bus.put(keys.robot_frames("r1"), frame("r1", 8, 100))
                await asyncio.wait({line}, timeout=0.05)
    finally:
        process.kill()
        await process.wait()
    text = line.result().decode()
    message = json.loads(text[text.index("{") :])
    assert (message["message"], message["robot"], message["seq"]) == ("Frame", "r1", 8)
    assert message["data"] == "<100 bytes>"
