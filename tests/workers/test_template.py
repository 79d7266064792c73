"""Workers forked from a warm template: they are apart from each other, and none is left behind."""

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
from common.workers import Template, WorkerError
from common.workers.worker import spawn

TARGET = "tests.workers.calculator:Calculator"


@pytest.fixture
async def template() -> AsyncIterator[Template]:
    template = await Template.start(TARGET, how="well")
    yield template
    await template.close()


async def test_a_forked_worker_is_warm_and_what_it_does_changes_no_other(template: Template) -> None:
    one, two = await asyncio.gather(template.fork(), template.fork())
    await one.call("later", rounds=3)
    while await one.call("done") < 10:
        pass
    three = await template.fork()
    assert [await worker.call("done") for worker in (one, two, three)] == [10, 7, 7]
    assert len({await worker.call("pid") for worker in (one, two, three)} | {template.process.pid}) == 4
    for worker in (one, two, three):
        await worker.close()


async def test_a_forked_worker_that_dies_says_how_and_others_go_on(template: Template) -> None:
    one, two = await template.fork(), await template.fork()
    with pytest.raises(WorkerDied, match="ended with -9"):
        await one.call("die")
    assert (one.gone.is_set(), one.process.returncode) == (True, -9)
    assert await two.call("add", a=1, b=2) == 3
    await two.close()
    assert two.process.returncode == -9


async def test_workers_go_on_when_their_template_dies_and_it_forks_no_more(template: Template) -> None:
    one, two = await template.fork(), await template.fork()
    template.process.kill()
    await template.gone.wait()
    with pytest.raises(WorkerDied, match="template"):
        await template.fork()
    assert await one.call("add", a=1, b=2) == 3
    with pytest.raises(WorkerDied):
        await one.call("die")
    assert one.gone.is_set()
    await two.close()
    assert await asyncio.to_thread(gone, {one.process.pid, two.process.pid})


async def test_a_worker_that_ended_after_its_template_is_not_killed_again(
    template: Template, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = await template.fork()
    template.process.kill()
    await template.gone.wait()
    with pytest.raises(WorkerDied):
        await worker.call("die")
    killed: list[int] = []
    monkeypatch.setattr(os, "kill", lambda pid, number: killed.append(pid))
    await worker.close()
    assert killed == [], "by now this may be the number of another process"


async def test_a_template_that_dies_while_it_is_asked_for_a_worker_says_so(template: Template) -> None:
    os.kill(template.process.pid, signal.SIGSTOP)
    asked = asyncio.create_task(template.fork())
    await asyncio.sleep(0)
    template.process.kill()
    with pytest.raises(WorkerDied, match="template"):
        await asked


async def test_a_worker_that_nobody_waits_for_any_more_ends(template: Template) -> None:
    os.kill(template.process.pid, signal.SIGSTOP)
    asked = asyncio.create_task(template.fork())
    await asyncio.sleep(0)
    asked.cancel()
    os.kill(template.process.pid, signal.SIGCONT)
    worker = await template.fork()
    assert await asyncio.to_thread(gone, offspring(template.process.pid) - {worker.process.pid})
    await worker.close()


@pytest.mark.parametrize(("how", "why"), [("fail", "ValueError: too cold"), ("thread", "2 threads")])
async def test_a_class_that_cannot_be_warmed_or_not_be_forked_is_no_template(how: str, why: str) -> None:
    with pytest.raises(WorkerError, match=why):
        await Template.start(TARGET, how=how)


async def test_a_start_that_is_broken_off_as_the_template_gets_ready_is_broken_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def spawned_and_ready(*arguments: str) -> tuple[asyncio.subprocess.Process, socket.socket]:
        process, channel = await spawn(*arguments)
        select.select([channel], [], [], 60)
        starting.cancel()
        return process, channel

    monkeypatch.setattr("common.workers.template.spawn", spawned_and_ready)
    starting = asyncio.create_task(Template.start(TARGET, how="well"))
    with pytest.raises(asyncio.CancelledError):
        await starting


async def test_a_class_that_cannot_be_made_is_no_template() -> None:
    with pytest.raises(WorkerError, match="Nobody"):
        await Template.start("tests.workers.calculator:Nobody", how="well")


@pytest.mark.parametrize("how", ["well", "spin"])
def test_neither_template_nor_worker_outlives_a_parent_killed_with_9(how: str) -> None:
    code = (
        "import asyncio\n"
        "from common.workers import Template\n"
        "async def main():\n"
        f"    template = await Template.start({TARGET!r}, how={how!r})\n"
        "    worker = await template.fork()\n"
        "    print('up', flush=True)\n"
        "    await worker.call('spin')\n"
        "asyncio.run(main())\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    if how == "well":
        assert parent.stdout is not None
        parent.stdout.readline()
        assert len(offspring(parent.pid)) == 2
    else:
        while not any(spins(pid) for pid in offspring(parent.pid)):
            time.sleep(0.05)
    born = offspring(parent.pid)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    assert gone(born)


def offspring(pid: int) -> set[int]:
    """Children and their children."""
    own = {int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()}
    return own | {each for child in own for each in offspring(child)}


def spins(pid: int) -> bool:
    """Is it amid a `warm` that does not end?"""
    return "spinning" in Path(f"/proc/{pid}/comm").read_text()


def gone(pids: set[int], within_s: float = 20.0) -> bool:
    """Are all of these ended, or become so?"""
    deadline = time.monotonic() + within_s
    while any(alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not any(alive(pid) for pid in pids)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
