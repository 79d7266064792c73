"""Exit codes, signals, parent watch and logs that all services share."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from common.errors import UsageError
from common.parent import PARENT_FD, Leash, watch_parent
from common.service import arguments, load_fleet
from common.telemetry import Formatter, process_stats

WAITING = """
    import asyncio
    from common.service import run

    async def main(stop: asyncio.Event) -> None:
        print("ready", flush=True)
        await stop.wait()
        print("clean", flush=True)

    raise SystemExit(run(main, "test"))
"""
FAILING = """
    import asyncio
    from common.errors import UsageError
    from common.service import run

    async def main(stop: asyncio.Event) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fail(), name="fail")

    async def fail() -> None:
        raise {error}

    raise SystemExit(run(main, "test"))
"""


def start(program: str, **options: object) -> subprocess.Popen[str]:
    return subprocess.Popen(  # type: ignore[call-overload, no-any-return]
        [sys.executable, "-c", textwrap.dedent(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_a_service_cleanly(number: signal.Signals) -> None:
    with start(WAITING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out) == (0, "clean\n"), err
    assert f"signal={number.name}" in err


def test_a_usage_error_in_a_task_is_one_line_and_exit_code_2() -> None:
    with start(FAILING.format(error="UsageError('give a spool')")) as process:
        _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert err == "test: give a spool\n"


def test_an_unexpected_error_shows_its_traceback_and_exit_code_1() -> None:
    with start(FAILING.format(error="KeyError('oops')")) as process:
        _, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "Traceback" in err
    assert "KeyError: 'oops'" in err


def test_kill_minus_9_of_the_parent_leaves_no_orphan() -> None:
    parent_program = f"""
        import os, subprocess, sys
        from common.parent import Leash

        leash = Leash()
        child = subprocess.Popen(
            [sys.executable, "-c", {textwrap.dedent(WAITING)!r}],
            pass_fds=leash.pass_fds,
            env=os.environ | leash.environment,
        )
        child.wait()
    """
    with start(parent_program) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "ready\n"
        parent.kill()
        assert parent.stdout.read() == "clean\n"  # ends only when the child has closed its copy, too


def test_a_leash_that_names_no_pipe_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PARENT_FD, "999")
    with pytest.raises(UsageError, match="999"):
        watch_parent(lambda: None)


def test_without_a_parent_nothing_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PARENT_FD, raising=False)
    assert not watch_parent(lambda: None)


def test_closing_a_leash_twice_is_harmless() -> None:
    with Leash() as leash:
        leash.close()


def test_the_endpoint_comes_from_the_command_line_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    parser = arguments("robot_agent", "")
    assert load_fleet(parser.parse_args([])).bus.endpoint == "tcp/127.0.0.1:7447"
    monkeypatch.setenv("RECSLAM_ENDPOINT", "tcp/10.0.0.1:1")
    assert load_fleet(parser.parse_args([])).bus.endpoint == "tcp/10.0.0.1:1"
    assert load_fleet(parser.parse_args(["--endpoint", "tcp/10.0.0.2:2"])).bus.endpoint == "tcp/10.0.0.2:2"


def record(**fields: object) -> logging.LogRecord:
    return logging.makeLogRecord({"msg": "scan %s", "args": ("refused",), "levelname": "WARNING", **fields})


def test_a_log_line_can_be_split_into_its_pairs() -> None:
    line = Formatter("robot/r1", "kv").format(record(robot="r 1", ms=0.123456789))
    assert 'level=warning service=robot/r1 message="scan refused" robot="r 1" ms=0.123457' in line


def test_a_log_line_stays_one_line_whatever_is_in_it() -> None:
    assert "\n" not in Formatter("r", "kv").format(record(reason='two\nlines with "quotes"'))


def test_a_json_log_line_is_json() -> None:
    fields = json.loads(Formatter("robot/r1", "json").format(record(seq=3)))
    assert (fields["service"], fields["message"], fields["seq"]) == ("robot/r1", "scan refused", 3)


def test_process_stats_add_up_living_children_only() -> None:
    own = process_stats()
    assert own.rss_mb > 5
    assert process_stats([os.getpid()]).rss_mb > own.rss_mb * 1.5
    assert process_stats([2**22 + 1]).rss_mb < own.rss_mb * 1.5
