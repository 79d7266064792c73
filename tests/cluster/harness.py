"""A cluster of real processes around a test: started, killed, watched; nothing outlives it."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

from common.bus import Bus, Router, keys
from common.config import Fleet
from common.errors import PeerError
from common.parent import Leash
from common.wire import Ack, EdgeStatus, GlobalMapNotice, Message, SchedulerStatus
from services.command import fleets

M = TypeVar("M", bound=Message)

PATIENCE_S = 100.0
"""for anything to happen on a loaded machine; a test that passes never waits this long"""
POLL_S = 0.05
BAD_WORDS = ("Traceback", "never retrieved", "never awaited", "was destroyed but")


def fleet(
    names: tuple[str, ...] = ("r1", "r2"), count: int = 2, duration_s: float = 20.0, lidar: str = "lds01", **fields: Any
) -> Fleet:
    """Robots of the two rooms who stop early."""
    source = {"kind": "sim", "scene": "two_rooms", "lidar": lidar, "speed_mps": 0.5, "duration_s": duration_s}
    defaults: dict[str, Any] = {
        "seed": 1,
        "batch": True,
        "edge": {"workers": 1, "map_every_s": 0.5},
        "cloud": {"merge_every_s": 0.5},
        "bus": {"grace_s": 2.0},
        "scheduler": {"interval_s": 1.0},
        "robots": tuple({"id": robot, "source": source} for robot in names),
        "edges": tuple({"id": f"edge-{k}"} for k in range(1, count + 1)),
    }
    return Fleet(**(defaults | fields))


class Cluster:
    """Services by name: `scheduler`, `cloud`, edges and robots by their ids."""

    def __init__(self, fleet: Fleet, folder: Path, endpoint: str, bus: Bus, leash: Leash) -> None:
        self.fleet, self.folder, self.endpoint, self.bus = fleet, folder, endpoint, bus
        self._leash = leash
        self.processes: dict[str, asyncio.subprocess.Process] = {}
        self.config = folder / "fleet.toml"
        fleets.write(fleet, self.config)

    async def start(self, *names: str) -> None:
        for name in names:
            log = (self.folder / f"{name}.log").open("ab")
            self.processes[name] = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                *self._program(name),
                "--config",
                str(self.config),
                "--endpoint",
                self.endpoint,
                stdout=log,
                stderr=log,
                pass_fds=self._leash.pass_fds,
                env={**os.environ, **self._leash.environment},
                start_new_session=True,
            )

    async def start_all(self, *but: str) -> None:
        robots = [robot.id for robot in self.fleet.robots]
        await self.start(*(n for n in ("scheduler", "cloud", *self.fleet.edge_ids(), *robots) if n not in but))

    async def kill(self, name: str) -> None:
        """kill -9, waited for."""
        self.processes[name].kill()
        await self.processes[name].wait()

    async def stop(self, *names: str) -> list[int]:
        """SIGTERM to these (all that run by default), and their exit codes."""
        chosen = [self.processes[name] for name in names or self.processes]
        for process in chosen:
            if process.returncode is None:
                process.terminate()
        return list(await asyncio.gather(*(process.wait() for process in chosen)))

    async def hear(self, key: str, kind: type[M], wanted: Callable[[M], bool]) -> M:
        """The first message of the key for which `wanted` holds. Fails after the patience is over."""
        stream = self.bus.watch(key)
        try:
            async with asyncio.timeout(PATIENCE_S):
                async for received in stream:
                    if isinstance(received.message, kind) and wanted(received.message):
                        return received.message
        except TimeoutError:
            raise AssertionError(f"nothing wanted came on {key}\n{await self.state()}") from None
        finally:
            stream.close()
        raise AssertionError(f"the bus has closed under {key}")

    async def final(self) -> GlobalMapNotice:
        robots = {robot.id for robot in self.fleet.robots}
        return await self.hear(keys.CLOUD_MAP, GlobalMapNotice, lambda n: n.final and robots <= set(n.covers))

    async def edge_status(self, edge: str, wanted: Callable[[EdgeStatus], bool] = lambda _: True) -> EdgeStatus:
        return await self.hear(keys.edge_status(edge), EdgeStatus, wanted)

    async def scheduler_status(self, wanted: Callable[[SchedulerStatus], bool]) -> SchedulerStatus:
        return await self.hear(keys.SCHEDULER_STATUS, SchedulerStatus, wanted)

    async def processed(self, robot: str, frames: int) -> str:
        """Wait until so many frames of the robot are processed; the edge that runs it."""
        ack = await self.hear(keys.edge_ack(keys.ANY, robot), Ack, lambda ack: ack.processed >= frames)
        return ack.edge

    async def state(self) -> str:
        """Everybody's status, to see why a test has failed."""
        lines = [f"{name}: exit code {process.returncode}" for name, process in self.processes.items()]
        for key in (keys.edge_status(keys.ANY), keys.CLOUD_STATUS, keys.SCHEDULER_STATUS, keys.SCHEDULER_ROUTES):
            try:
                answers = await self.bus.get(key, everyone=True)
                lines += [f"{answer.key}: {answer.message}" for answer in answers]
            except PeerError as error:
                lines.append(f"{key}: {error}")
        return "\n".join(lines)

    def faults(self) -> list[str]:
        """Lines of the logs that no run should have."""
        return [
            f"{log.name}: {line}"
            for log in sorted(self.folder.glob("*.log"))
            for line in log.read_text(errors="replace").splitlines()
            if any(word in line for word in BAD_WORDS)
        ]

    def _program(self, name: str) -> list[str]:
        if name == "scheduler":
            return ["services.scheduler"]
        if name == "cloud":
            return ["services.cloud_merger"]
        if name in self.fleet.edge_ids():
            return ["services.edge_worker", "--id", name]
        return ["services.robot_agent", "--id", name, "--spool", str(self.folder / "spool")]


@asynccontextmanager
async def cluster(fleet: Fleet, folder: Path) -> AsyncIterator[Cluster]:
    """A router and nothing else yet; whatever is started ends with the block."""
    async with await Router.open() as router, await Bus.open(router.endpoint, name="test", role="test") as bus:
        with Leash() as leash:
            made = Cluster(fleet, folder, router.endpoint, bus, leash)
            try:
                yield made
            finally:
                for process in made.processes.values():
                    if process.returncode is None:
                        os.killpg(process.pid, signal.SIGKILL)
                await asyncio.gather(*(process.wait() for process in made.processes.values()))


def children(pid: int) -> set[int]:
    """All living descendants of a process."""
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            own = {int(child) for child in task.read_text().split()}
        except OSError:
            continue
        found |= own | {each for child in own for each in children(child)}
    return found


async def has_children(pid: int) -> set[int]:
    """The descendants of a process, once it has any."""
    for _ in range(int(PATIENCE_S / POLL_S)):
        if found := children(pid):
            return found
        await asyncio.sleep(POLL_S)
    raise AssertionError(f"{pid} starts no process")


def alive(pids: set[int]) -> set[int]:
    """Those that still run (a zombie does not)."""

    def runs(pid: int) -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
        except OSError:
            return False

    return {pid for pid in pids if runs(pid)}


async def all_gone(pids: set[int]) -> bool:
    """Whether all of these end within the patience."""
    for _ in range(int(PATIENCE_S / POLL_S)):
        if not alive(pids):
            return True
        await asyncio.sleep(POLL_S)
    return False
