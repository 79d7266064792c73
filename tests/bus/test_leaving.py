from __future__ import annotations

import signal

import pytest
from probes import OpenBus, Start, number

from common.bus import keys

pytestmark = pytest.mark.timeout(40)


@pytest.mark.parametrize(
    ("how", "code"), [("return", 0), ("exception", 1), ("exit", 3), ("forget", 0), ("forget-and-raise", 1)]
)
def test_a_process_ends_whichever_way_it_leaves(endpoint: str, root: str, start: Start, how: str, code: int) -> None:
    process, ready = start("leave", endpoint, root, how)
    assert ready == "ready"
    assert process.wait() == code
    assert process.stderr is not None
    errors = process.stderr.read()
    assert "FATAL" not in errors
    assert ("Traceback" in errors) == (code == 1)


@pytest.mark.parametrize(("number_of", "code"), [(signal.SIGTERM, 1), (signal.SIGINT, -signal.SIGINT)])
def test_a_process_ends_by_a_signal(
    endpoint: str, root: str, start: Start, number_of: signal.Signals, code: int
) -> None:
    process, ready = start("leave", endpoint, root, "signal")
    assert ready == "ready"
    process.send_signal(number_of)
    assert process.wait() == code
    assert process.stderr is not None
    assert process.stderr.read().strip().splitlines()[-1] in {"asyncio.exceptions.CancelledError", "KeyboardInterrupt"}


async def test_a_spawned_child_opens_a_bus_of_its_own(start: Start, endpoint: str, root: str) -> None:
    process, epoch = start("spawn", endpoint, root)
    assert epoch == "(1, 5)"
    assert process.wait() == 0
    assert process.stdout is not None
    assert process.stdout.read().strip() == "0"


async def test_others_go_on_when_one_leaves(open_bus: OpenBus, endpoint: str, root: str, start: Start) -> None:
    bus = await open_bus()
    stream = bus.watch(keys.SCHEDULER_ROUTES)
    for _ in range(2):
        process, _ready = start("leave", endpoint, root, "return")
        assert number(await anext(stream)) == 1
        process.wait()
    assert bus.connected
