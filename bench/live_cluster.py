"""The scheduler in live clusters: real processes, a real router, simulated robots in real time.

    python -m bench.live_cluster --part steady|throttled|moving [--policy recslam|paper ...]

`steady`: five robots map two rooms and then stand still for ten minutes: nothing changes but the noise of measurements.
`throttled`: the edge that runs the most robots gets a CPU limit (a cgroup of its own: this needs root), later lifted.
`moving`: one robot crosses from one room to the other and stands in the corridor at last.

Writes results/live_cluster.json.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import os
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from bench.results import append, show
from common.bus import Bus, Router, keys
from common.config import EdgeEntry, Fleet, RobotConfig, RobotEntry, SchedulerConfig, SimSource
from common.errors import UsageError
from common.wire import EdgeStatus, EndOfStream, GlobalMapNotice, RobotStatus, Routes
from services.command import fleets
from services.command.children import Children
from services.command.run_folder import RunFolder
from services.command.topology import programs

DRIVE_S = 130.0
"""after which the slowest of the robots of two_rooms stands still"""
SETTLE_S = 50.0
STAND_S = 600.0
INTERVAL_S = 3.0
RELIEF_S = 90.0
LEFT = 0.25
"""of what it has used, when an edge is throttled"""
CPU_ROOT = Path("/sys/fs/cgroup")
PERIOD_US = 100_000


def two_rooms(policy: str, robots: str = "r1 r2 r3 r4 r5", edges: int = 2, duration_s: float | None = None) -> Fleet:
    source = SimSource(scene="two_rooms", lidar="lds01", speed_mps=0.5, duration_s=duration_s)
    return Fleet(
        name="two_rooms",
        seed=1,
        robots=tuple(RobotEntry(id=robot, source=source) for robot in robots.split()),
        edges=tuple(EdgeEntry(id=f"edge-{number}") for number in range(1, edges + 1)),
        robot=RobotConfig(realtime=True),
        scheduler=SchedulerConfig(policy=policy, interval_s=INTERVAL_S),
        batch=True,
    )


class Watched:
    """What the scheduler, the edges and the cloud say of a running cluster."""

    def __init__(self, bus: Bus, children: Children) -> None:
        self.bus, self.children = bus, children
        self.tables: list[tuple[float, Routes]] = []
        self.maps: list[GlobalMapNotice] = []
        self.edges: dict[str, EdgeStatus] = {}
        self.robots: dict[str, RobotStatus] = {}
        self.ends: dict[str, int] = {}
        self.begin = time.monotonic()
        self.news = asyncio.Event()

    async def hear(self, key: str) -> None:
        async for received in self.bus.watch(key):
            match received.message:
                case Routes() as routes:
                    self.tables.append((self.now(), routes))
                case GlobalMapNotice() as notice:
                    self.maps.append(notice)
                case EdgeStatus() as status:
                    self.edges[status.edge] = status
                case RobotStatus() as status:
                    self.robots[status.robot] = status
                case EndOfStream() as end:
                    self.ends[end.robot] = end.last_seq
            self.news.set()

    def now(self) -> float:
        return time.monotonic() - self.begin

    def moves(self, after: float, field: str) -> list[tuple[float, str, str]]:
        """(s, robot, edge) for each change of `slam_edge` or `fuse_edge` later than `after`."""
        found, before = [], {}
        for when, table in self.tables:
            named = {robot: getattr(route, field) for robot, route in table.routes.items()}
            if when > after:
                found += [(when, robot, edge) for robot, edge in named.items() if before.get(robot, edge) != edge]
            before = named
        return found

    def behind(self, edge: str) -> int:
        """Frames that the robots run at this edge have made and it has not processed."""
        instances = self.edges[edge].instances if edge in self.edges else ()
        return sum(self.robots[each.robot].sent - 1 - each.processed for each in instances if each.robot in self.robots)

    async def until(self, seconds: float) -> None:
        await asyncio.sleep(max(0.0, seconds - self.now()))

    async def once(self, holds: Callable[[], bool]) -> None:
        """Return as soon as `holds` does."""
        while not holds():
            self.news.clear()
            await self.news.wait()

    async def final(self) -> GlobalMapNotice:
        await self.once(lambda: bool(self.maps) and self.maps[-1].final)
        return self.maps[-1]


@asynccontextmanager
async def cluster(fleet: Fleet, out: Path) -> AsyncIterator[Watched]:
    """All services of the fleet; leaving it stops them."""
    folder = RunFolder(out)
    folder.logs.mkdir(parents=True)
    fleets.write(fleet, folder.config)
    async with (
        await Router.open() as router,
        await Bus.open(router.endpoint, name="bench", role="command") as bus,
        Children(folder, router.endpoint) as children,
        asyncio.TaskGroup() as tasks,
    ):
        watched = Watched(bus, children)
        of_robots = (keys.robot_status(keys.ANY), keys.robot_end(keys.ANY))
        heard = (keys.SCHEDULER_ROUTES, keys.CLOUD_MAP, keys.edge_status(keys.ANY), *of_robots)
        listening = [tasks.create_task(watched.hear(key)) for key in heard]
        listening.append(tasks.create_task(children.watch()))
        for program in programs(fleet, folder.spool):
            await children.start(program)
        await watched.once(lambda: bool(watched.tables) and len(watched.tables[-1][1].routes) == len(fleet.robots))
        watched.begin += watched.now()
        watched.tables = [(0.0, watched.tables[-1][1])]
        yield watched
        for task in listening:
            task.cancel()


async def steady(policy: str, out: Path) -> dict[str, Any]:
    async with cluster(two_rooms(policy, duration_s=DRIVE_S + SETTLE_S + STAND_S + 60), out) as seen:
        await seen.until(DRIVE_S + SETTLE_S)
        loads = []
        while seen.now() < DRIVE_S + SETTLE_S + STAND_S:
            loads.append(os.getloadavg()[0])
            await asyncio.sleep(5)
        fused = {robot: route.fuse_edge for robot, route in seen.tables[-1][1].routes.items()}
        return {
            "policy": policy,
            "seconds": STAND_S,
            "SLAM moved": len(seen.moves(DRIVE_S + SETTLE_S, "slam_edge")),
            "fusing edges changed": len(seen.moves(DRIVE_S + SETTLE_S, "fuse_edge")),
            "SLAM moved before": len(seen.moves(0, "slam_edge")),
            "fusing edges changed before": len(seen.moves(0, "fuse_edge")),
            "rooms mixed": mixed(fused),
            "load": sum(loads) / len(loads),
        }


def mixed(fused: dict[str, str]) -> bool:
    """Whether an edge fuses robots of both rooms; r5 has been in both."""
    west, east = ({fused[robot] for robot in room} for room in (("r1", "r2"), ("r3", "r4")))
    return bool(west & east)


async def throttled(policy: str, out: Path) -> dict[str, Any]:
    async with cluster(two_rooms(policy, edges=3, duration_s=240.0), out) as seen:
        await seen.until(40)
        before = {edge: status.cpu_s for edge, status in seen.edges.items()}
        await seen.until(60)
        running = Counter(route.slam_edge for route in seen.tables[-1][1].routes.values())
        edge, robots = running.most_common(1)[0]
        used = (seen.edges[edge].cpu_s - before[edge]) / 20
        share = used * LEFT
        begin, behind = seen.now(), 0
        with cpu_limit(family(seen.children.pid(f"edge/{edge}")), share):
            while seen.now() < begin + RELIEF_S:
                await asyncio.sleep(0.2)
                behind = max(behind, seen.behind(edge))
        after = seen.moves(begin, "slam_edge")
        left = [(when - begin, robot) for when, robot, to in after if to != edge]
        final = await seen.final()
        return {
            "policy": policy,
            "cores used before": used,
            "cores left to it": share,
            "robots before": robots,
            "first left after s": left[0][0] if left else float("nan"),
            "robots left": len(left),
            "last left after s": left[-1][0] if left else float("nan"),
            "frames behind at most": behind,
            "moved in all": len(after),
            "final covers": len(final.covers),
            "frames missing": missing(seen, final),
        }


async def moving(policy: str, out: Path) -> dict[str, Any]:
    async with cluster(two_rooms(policy, duration_s=DRIVE_S + SETTLE_S), out) as seen:
        final = await seen.final()
        edges = [table.routes["r5"].fuse_edge for _, table in seen.tables]
        return {
            "policy": policy,
            "fusing edges of r5": [edge for edge, _ in itertools.groupby(edges)],
            "fusing edges changed": len(seen.moves(0, "fuse_edge")),
            "SLAM moved": len(seen.moves(0, "slam_edge")),
            "robots lost on the way": sum(
                not set(one.covers) <= set(other.covers) for one, other in itertools.pairwise(seen.maps)
            ),
            "frames missing": missing(seen, final),
            "components": len(final.components),
            "rooms mixed": mixed({robot: route.fuse_edge for robot, route in seen.tables[-1][1].routes.items()}),
        }


def missing(seen: Watched, final: GlobalMapNotice) -> int:
    """Frames that robots have made and the final map has not."""
    return sum(last - final.covers[robot].seq for robot, last in seen.ends.items())


def family(pid: int) -> set[int]:
    """The process and all its descendants."""
    found = {pid}
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            found |= family(int(child))
    return found


@contextmanager
def cpu_limit(pids: set[int], share: float) -> Iterator[None]:
    """Let these processes together use this share of one core. Raises UsageError where that takes more rights."""
    first = (CPU_ROOT / "cpu").is_dir()
    group = CPU_ROOT / "cpu" / f"bench-{os.getpid()}" if first else CPU_ROOT / f"bench-{os.getpid()}"
    quota = max(1000, round(share * PERIOD_US))
    try:
        group.mkdir()
        if first:
            (group / "cpu.cfs_quota_us").write_text(str(quota))
        else:
            (group / "cpu.max").write_text(f"{quota} {PERIOD_US}")
        for pid in pids:
            (group / "cgroup.procs").write_text(str(pid))
    except OSError as error:
        raise UsageError(f"cannot limit CPU time: {error}; run as root, or in a container that may") from error
    try:
        yield
    finally:
        for pid in (group / "cgroup.procs").read_text().split():
            (group.parent / "cgroup.procs").write_text(pid)
        group.rmdir()


PARTS = {"steady": steady, "throttled": throttled, "moving": moving}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS)
    parser.add_argument("--policy", action="append", help="may be given again (default: recslam, paper)")
    parser.add_argument("--times", type=int, default=1)
    options = parser.parse_args()
    for part in options.part or PARTS:
        rows = []
        for policy in (options.policy or ["recslam", "paper"]) * options.times:
            with tempfile.TemporaryDirectory(prefix="live-") as out:
                rows.append(asyncio.run(PARTS[part](policy, Path(out) / "run")))
            show(rows[-1:])
        print(f"written to {append('live_cluster', {part: rows})}")


if __name__ == "__main__":
    main()
