"""Worker processes: calls, failures, deaths, and that none is left behind."""

from __future__ import annotations

import asyncio
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from common.errors import WorkerDied
from common.workers import Worker, WorkerError

TARGET = "tests.workers.calculator:Calculator"


@pytest.fixture
async def worker() -> AsyncIterator[Worker]:
    worker = await Worker.start(TARGET)
    yield worker
    await worker.close()


async def test_calls_are_answered_in_order(worker: Worker) -> None:
    sums = await asyncio.gather(*(worker.call("add", a=n, b=1) for n in range(50)))
    assert sums == list(range(1, 51))


async def test_a_failing_call_says_why_and_the_worker_goes_on(worker: Worker) -> None:
    with pytest.raises(WorkerError, match="ValueError: no such sum"):
        await worker.call("fail")
    assert await worker.call("add", a=1, b=2) == 3


async def test_what_can_wait_is_done_without_being_asked_for_again(worker: Worker) -> None:
    await worker.call("later", rounds=200)
    looks = 1
    while await worker.call("done") < 200:
        looks += 1
        await asyncio.sleep(0.02)
    assert looks < 100


async def test_what_can_wait_and_fails_does_not_end_the_worker(worker: Worker) -> None:
    await worker.call("tire")
    assert await worker.call("add", a=1, b=2) == 3
    assert await worker.call("add", a=1, b=2) == 3


async def test_a_call_that_cannot_be_sent_is_not_taken_for_one_being_worked_on(worker: Worker) -> None:
    with pytest.raises(OverflowError):
        await worker.call("add", a=1 << 64, b=1)
    assert worker.at_work is None
    assert await worker.call("add", a=1, b=2) == 3


async def test_private_methods_cannot_be_called(worker: Worker) -> None:
    with pytest.raises(WorkerError, match="not to be called"):
        await worker.call("__init__")


async def test_death_fails_every_call_in_flight_and_every_later_one(worker: Worker) -> None:
    calls = [asyncio.create_task(worker.call(name)) for name in ("die", "pid", "pid")]
    for result in await asyncio.gather(*calls, return_exceptions=True):
        assert isinstance(result, WorkerDied)
    with pytest.raises(WorkerDied):
        await worker.call("pid")
    assert worker.gone.is_set()


async def test_a_class_that_cannot_be_made_is_a_death_not_a_hang() -> None:
    worker = await Worker.start("tests.workers.calculator:Nobody")
    with pytest.raises(WorkerDied):
        await worker.call("pid")
    await worker.close()


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_a_busy_worker_does_not_outlive_a_parent_killed_with_9() -> None:
    code = (
        "import asyncio\n"
        "from common.workers import Worker\n"
        "async def main():\n"
        f"    worker = await Worker.start({TARGET!r})\n"
        "    print(await worker.call('pid'), flush=True)\n"
        "    await worker.call('spin')\n"
        "asyncio.run(main())\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert alive(child)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    deadline = time.monotonic() + 10
    while alive(child) and time.monotonic() < deadline:
        os.sched_yield()
    assert not alive(child)


def test_a_worker_whose_parent_died_with_answers_unread_ends_without_a_word() -> None:
    # the socket then says "connection reset", not "end of file"
    ours, theirs = socket.socketpair()
    child = subprocess.Popen(
        [sys.executable, "-m", "common.workers.child", TARGET, str(theirs.fileno())],
        pass_fds=(theirs.fileno(),),
        stderr=subprocess.PIPE,
        text=True,
    )
    theirs.close()
    select.select([ours], [], [], 60)  # it has said that it is ready, and nobody reads it
    ours.close()
    _, said = child.communicate(timeout=60)
    assert (child.returncode, said) == (0, "")
