"""The robot's agent as a program: started, stopped, killed and started again."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common.bus import Bus, keys
from common.parent import Leash
from common.wire import EndOfStream, Frame, FramePage, RobotStatus, decode

pytestmark = pytest.mark.timeout(60)

Start = Callable[..., subprocess.Popen[str]]
ROWS = 400


@pytest.fixture
def fleet_file(tmp_path: Path, root: str) -> Path:
    row = "FLASER 4 1.0 2.0 3.0 4.0 {x} 0.0 0.0 {x} 0.0 0.0 {t} host {t}\n"
    (tmp_path / "tiny.log").write_text("".join(row.format(x=0.1 * i, t=1000.0 + 0.01 * i) for i in range(ROWS)))
    path = tmp_path / "fleet.toml"
    path.write_text(
        f"""
        bus.root = "{root}"
        edge.window = 4096
        [[robots]]
        id = "r1"
        source = {{kind = "carmen", path = "{tmp_path / "tiny.log"}"}}
        """
    )
    return path


@pytest.fixture
def start(endpoint: str, fleet_file: Path, tmp_path: Path) -> Iterator[Start]:
    processes: list[subprocess.Popen[str]] = []

    def start_one(*arguments: str, **options: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "services.robot_agent", "--config", str(fleet_file), "--id", "r1"]
        command += ["--endpoint", endpoint, "--spool", str(tmp_path / "spool"), *arguments]
        process: subprocess.Popen[str] = subprocess.Popen(  # type: ignore[call-overload]
            command, stderr=subprocess.PIPE, text=True, **options
        )
        processes.append(process)
        return process

    yield start_one
    for process in processes:
        with process:
            process.kill()


@pytest.fixture
async def edge(endpoint: str, root: str) -> object:
    async with await Bus.open(endpoint, name="e1", role="edge", root=root) as bus:
        yield bus


async def sent(bus: Bus, process: subprocess.Popen[str], at_least: int) -> RobotStatus:
    async for received in bus.watch(keys.robot_status("r1")):
        status = received.message
        if isinstance(status, RobotStatus) and status.sent >= at_least:
            return status
    raise AssertionError(process.communicate()[1])


async def code(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, err = await asyncio.to_thread(process.communicate)
    return process.returncode, err


async def test_kill_minus_9_and_a_restart_lose_no_frame_and_repeat_none(start: Start, edge: Bus) -> None:
    frames = edge.subscribe(keys.robot_frames("r1"), depth=2 * ROWS)
    first = start("--realtime")
    heard: dict[int, Frame] = {}
    async for received in frames:
        assert isinstance(received.message, Frame)
        heard[received.message.seq] = received.message
        if len(heard) == 40:
            break
    first.send_signal(signal.SIGKILL)
    await code(first)
    second = start()
    async for received in edge.watch(keys.robot_end("r1")):
        assert isinstance(received.message, EndOfStream)
        assert received.message.last_seq == ROWS - 1
        break
    spooled: list[Frame] = []
    async for page in edge.pages(keys.robot_backfill("r1"), {"from": 0}):
        assert isinstance(page, FramePage)
        spooled += [decode(data) for data in page.frames]  # type: ignore[misc]
    assert [frame.seq for frame in spooled] == list(range(ROWS))
    assert [frame.stamp for frame in spooled] == pytest.approx([1000.0 + 0.01 * i for i in range(ROWS)])
    assert all(
        spooled[seq].stream == frame.stream and spooled[seq].stamp == frame.stamp for seq, frame in heard.items()
    )
    second.terminate()
    assert (await code(second))[0] == 0


async def test_a_robot_whose_parent_dies_stops_by_itself(start: Start, edge: Bus) -> None:
    leash = Leash()
    process = start("--realtime", pass_fds=leash.pass_fds, env=os.environ | leash.environment)
    await sent(edge, process, 1)
    leash.close()
    exit_code, err = await code(process)
    assert (exit_code, "parent process is gone" in err) == (0, True)


async def test_a_name_that_is_in_use_is_exit_code_2(start: Start, edge: Bus, tmp_path: Path) -> None:
    await sent(edge, start(), 1)
    exit_code, err = await code(start("--spool", str(tmp_path / "other")))
    assert exit_code == 2
    assert "robot id 'r1' is in use" in err
    assert "Traceback" not in err


async def test_a_spool_that_is_in_use_is_exit_code_2(start: Start, edge: Bus) -> None:
    await sent(edge, start(), 1)
    exit_code, err = await code(start())
    assert exit_code == 2
    assert "another process has this spool open" in err


async def test_a_source_that_cannot_be_opened_is_exit_code_2(start: Start, tmp_path: Path) -> None:
    (tmp_path / "tiny.log").unlink()
    exit_code, err = await code(start())
    assert exit_code == 2
    assert "tiny.log" in err
    assert "Traceback" not in err
