"""The `recslam` command as the tests call it."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from pathlib import Path

RECSLAM = [sys.executable, "-c", "from services.cli import main; main()"]

FLEET = """
name = "pair"
seed = 3
batch = true
robots = [
    {{ id = "r1", source = {{ kind = "sim", scene = "asymmetric", duration_s = {seconds} }} }},
    {{ id = "r2", source = {{ kind = "sim", scene = "asymmetric", duration_s = {seconds} }} }},
]
edges = [{{ id = "edge-1" }}, {{ id = "edge-2" }}]
edge.workers = 1
"""


def write_fleet(folder: Path, more: str = "", seconds: float = 20) -> Path:
    path = folder / "pair.toml"
    path.write_text(FLEET.format(seconds=seconds) + more)
    return path


def call(*words: object, cwd: Path, timeout: float = 100, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [*RECSLAM, *map(str, words)]
    return subprocess.run(command, cwd=cwd, env=_env(environment), capture_output=True, text=True, timeout=timeout)


def start(*words: object, cwd: Path, **environment: str) -> subprocess.Popen[str]:
    command = [*RECSLAM, *map(str, words)]
    return subprocess.Popen(
        command, cwd=cwd, env=_env(environment), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def read_until(process: subprocess.Popen[str], text: str) -> str:
    """What the process prints up to the line with `text`; fails with all of it when there is none."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if text in line:
            return "".join(lines)
    raise AssertionError(f"{text!r} was never printed:\n{''.join(lines)}")


def family(parent: int) -> list[int]:
    """pids of all descendants of a process."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            children.setdefault(int(fields[1]), []).append(int(entry.name))
    found, todo = [], [parent]
    while todo:
        for child in children.get(todo.pop(), []):
            found.append(child)
            todo.append(child)
    return found


def all_gone(pids: list[int], within_s: float) -> bool:
    """Wait until none of the processes is left."""
    poll = select.poll()
    handles = []
    for pid in pids:
        try:
            handles.append(os.pidfd_open(pid))
        except ProcessLookupError:
            continue
    for handle in handles:
        poll.register(handle, select.POLLIN)
    left = set(handles)
    while left:
        ready = poll.poll(within_s * 1000)
        if not ready:
            break
        for handle, _ in ready:
            poll.unregister(handle)
            left.discard(handle)
    for handle in handles:
        os.close(handle)
    return not left


def _env(more: dict[str, str]) -> dict[str, str]:
    own = {name: value for name, value in os.environ.items() if not name.startswith("RECSLAM_")}
    return own | {"PYTHONPATH": str(Path(__file__).parents[2])} | more
