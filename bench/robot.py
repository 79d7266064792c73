"""What a robot's agent costs: `python -m bench.robot` prints a table and writes results/robot.json.

Sweeps are made beforehand: 10 a second, each with 5 odometry and 10 IMU samples. `pack` and `spool` run flat out,
`agent` is the whole agent at the sweeps' own pace, streaming to a router in another process. Each case is a process of
its own; CPU is user and system time of all its threads, and start-up is not counted.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from common.bus import Router
from common.config import BusConfig, EdgeConfig, Fleet, RobotEntry, SimSource
from common.sweep import LaserGeometry, Sweep
from common.wire import encode
from services.robot_agent.collector import Collector
from services.robot_agent.packing import pack
from services.robot_agent.service import RobotAgent
from services.robot_agent.sources.source import SourceProfile
from services.robot_agent.spool import Spool

RATE_HZ = 10
BEAMS = (360, 1081)
FLAT_OUT_FRAMES = 3000
AGENT_FRAMES = 150
RESULTS = Path("results/robot.json")


class Prepared:
    """A source whose sweeps exist before the clock starts."""

    def __init__(self, beams: int, count: int) -> None:
        self.profile = SourceProfile("prepared", "laser", 12.0, can_wait=True)
        rng = np.random.default_rng(1)
        geometry = LaserGeometry(-np.pi, 2 * np.pi / beams, 0.1, 12.0)
        ranges = rng.uniform(0.1, 12.0, (16, beams)).astype(np.float32)
        odometry, imu = rng.normal(size=(5, 4)), rng.normal(size=(10, 4))
        self._sweeps = [Sweep(i / RATE_HZ, geometry, ranges[i % 16], odometry, imu) for i in range(count)]

    def sweeps(self) -> Iterator[Sweep]:
        return iter(self._sweeps)


def run_pack(beams: int, folder: Path, endpoint: str) -> dict[str, Any]:
    sweeps = list(Prepared(beams, FLAT_OUT_FRAMES).sweeps())
    started = time.process_time(), time.perf_counter()
    size = sum(len(encode(pack(sweep, "r1", "0" * 32, seq))) for seq, sweep in enumerate(sweeps))
    return measured(*started, FLAT_OUT_FRAMES) | {"bytes_per_frame": size / FLAT_OUT_FRAMES}


def run_spool(beams: int, folder: Path, endpoint: str) -> dict[str, Any]:
    source = Prepared(beams, FLAT_OUT_FRAMES)
    with Spool(folder / "r1.spool", "r1", 2**30) as spool:
        collector = Collector(source, spool)
        started = time.process_time(), time.perf_counter()
        while not collector.take(1).ended:  # as a live source does: one commit a frame
            pass
        result = measured(*started, FLAT_OUT_FRAMES)
        payload = spool.now().bytes
    return result | {"file_over_payload": (folder / "r1.spool").stat().st_size / payload}


def run_agent(beams: int, folder: Path, endpoint: str) -> dict[str, Any]:
    return asyncio.run(_agent(beams, folder, endpoint))


async def _agent(beams: int, folder: Path, endpoint: str) -> dict[str, Any]:
    fleet = Fleet(bus=BusConfig(endpoint=endpoint), edge=EdgeConfig(window=4096))
    entry, stop = RobotEntry(id=f"bench-{beams}", source=SimSource(scene="none")), asyncio.Event()
    with Spool(folder / "r1.spool", entry.id, 2**30) as spool:
        collector = Collector(Prepared(beams, AGENT_FRAMES), spool, realtime=True)
        agent = RobotAgent(fleet, entry, collector, spool, stop)
        running = asyncio.create_task(agent.run())
        await asyncio.sleep(1.0)
        first, started = spool.now().next_seq, (time.process_time(), time.perf_counter())
        while not agent.state.ended:  # noqa: ASYNC110 - the agent is not told that it is watched
            await asyncio.sleep(0.2)
        result = measured(*started, AGENT_FRAMES - first) | {"pack_and_spool_us": agent.status().pack_s * 1e6}
        stop.set()
        await running
    return result


def measured(cpu_s: float, wall: float, frames: int) -> dict[str, Any]:
    cpu_s, wall = time.process_time() - cpu_s, time.perf_counter() - wall
    return {
        "frames": frames,
        "cpu_us_per_frame": cpu_s / frames * 1e6,
        "cpu_s_per_s": cpu_s / frames * RATE_HZ,
        "wall_us_per_frame": wall / frames * 1e6,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


CASES = {"pack": run_pack, "spool": run_spool, "agent": run_agent}


async def measure_all() -> list[dict[str, Any]]:
    rows = []
    async with await Router.open() as router:
        for beams in BEAMS:
            for name in CASES:
                command = [sys.executable, "-m", "bench.robot", "--case", name, "--beams", str(beams)]
                command += ["--endpoint", router.endpoint]
                done = await asyncio.to_thread(subprocess.run, command, stdout=subprocess.PIPE, check=True)
                rows.append({"case": name, "beams": beams, **json.loads(done.stdout)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", choices=CASES, help="only this one, in this process")
    parser.add_argument("--beams", type=int, default=BEAMS[0])
    parser.add_argument("--endpoint", default="")
    args = parser.parse_args()
    if args.case:
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(CASES[args.case](args.beams, Path(folder), args.endpoint)))
        return
    rows = asyncio.run(measure_all())
    print(f"{'case':6} {'beams':>5} {'CPU us/frame':>13} {'CPU s per s':>12} {'peak RSS MB':>12}  other")
    for row in rows:
        other = {k: round(row[k], 2) for k in ("bytes_per_frame", "file_over_payload", "pack_and_spool_us") if k in row}
        print(
            f"{row['case']:6} {row['beams']:5} {row['cpu_us_per_frame']:13.0f} {row['cpu_s_per_s']:12.5f} "
            f"{row['peak_rss_mb']:12.1f}  {other}"
        )
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps({"machine": platform.machine(), "rate_hz": RATE_HZ, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
