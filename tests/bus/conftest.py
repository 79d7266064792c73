"""Programs of bus_program.py as processes that do not outlive their test."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from probes import Process, Start


@pytest.fixture
def start() -> Iterator[Start]:
    """`start("what", endpoint, root, ...)`: the process and the first line that it printed."""
    processes: list[Process] = []

    def start_one(*arguments: str) -> tuple[Process, str]:
        program = Path(__file__).with_name("bus_program.py")
        process = subprocess.Popen(
            [sys.executable, str(program), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    yield start_one
    for process in processes:
        process.kill()
        process.communicate()
