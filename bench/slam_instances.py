"""Several robots in one SLAM worker: memory for each, how long a frame waits for its pose, when the worker is ready.

    RECSLAM_DATA=... python -m bench.slam_instances [--instances 4] [--kernel graph] [--log intel_dense] [--ready 5]

Each run is a process of its own in which all robots drive the same log, `APART_S` after one another. Frames come when
the log says, and maps and states are asked for as an edge does (`ASKED`). The worker does one thing after the
other, so that a frame waits for all that came before it: that wait is reckoned on the log's clock from the CPU time
that each call took, and what else the machine does counts for nothing. Between calls the worker does what can wait
(`SlamHost.idle`), and a frame that comes meanwhile waits for the end of a round. Memory is the peak, with a snapshot
of each robot at the end, over what the idle warm worker had. `--ready N`: instead, how soon N workers of an edge are
ready.
"""

from __future__ import annotations

import argparse
import asyncio
import heapq
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.slam import LOGS, OUT, data, sweeps
from common.telemetry import process_stats
from common.wire import encode
from common.workers import Template
from common.workers.child import REST_S
from services.edge_worker.pool import TARGET
from services.edge_worker.slam.host import SlamHost
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack

APART_S = 7.3
"""s between the starts of two robots, so that they are not all at the same place"""
ASKED = {"news": 0.5, "snapshot": 60.0}
"""s between two times that the host is asked for a robot's map, and for its state"""
KERNELS = ("graph", "gmapping")
SHARES = (0.5, 0.75, 1.0)
"""of all frames, after which memory is told"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instances", type=int, action="append")
    parser.add_argument("--kernel", action="append", choices=KERNELS)
    parser.add_argument("--log", action="append")
    parser.add_argument("--ready", type=int, metavar="N")
    parser.add_argument("--here", action="store_true", help="run in this process and print JSON")
    arguments = parser.parse_args()
    kernels, logs = arguments.kernel or KERNELS, arguments.log or ["intel_dense", "csail"]
    instances = arguments.instances or [1, 4]
    if arguments.here:
        print(json.dumps(measure(kernels[0], logs[0], instances[0])))
        return
    warmup()
    if arguments.ready:
        for kernel in kernels:
            print(ready_line(kernel, asyncio.run(ready(kernel, arguments.ready))), flush=True)
        return
    if any(log in LOGS for log in logs):
        data()
    rows = []
    for log in logs:
        for kernel in kernels:
            for number in instances:
                command = [sys.executable, "-m", "bench.slam_instances", "--here", "--kernel", kernel, "--log", log]
                command += ["--instances", str(number)]
                rows.append(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))
                print(line(rows[-1]), flush=True)
    OUT.mkdir(exist_ok=True)
    (OUT / "slam_instances.json").write_text(json.dumps(rows, indent=1))


def measure(kernel: str, log: str, robots: int) -> dict[str, Any]:
    """Drive `robots` through a log in one worker, this process."""
    with ProcessPoolExecutor(1, get_context("spawn")) as elsewhere:  # what it leaves free would hide what robots take
        stamps, calls = elsewhere.submit(packed, log).result()
    host = SlamHost()
    host.warm(kernel)
    idle, peak = process_stats().rss_mb, Peak()
    names = [f"r{number}" for number in range(robots)]
    for number, name in enumerate(names):
        host.open(name, 1, kernel, {}, number)
    clock = waits = 0.0
    poses, sizes, tasks = [], [], {"news": [], "snapshot": []}
    milestones = [round(share * robots * len(calls)) for share in SHARES]
    for due, name, what in schedule(stamps, names):
        more = True
        while more and clock + REST_S < due:
            begin = time.process_time()
            more = host.idle()
            clock += REST_S + time.process_time() - begin
        if isinstance(what, str):
            spent = timed(getattr(host, what), name)
            tasks[what].append(spent)
        else:
            spent = timed(host.process, name, calls[what])
        clock = max(clock, due) + spent
        if isinstance(what, int):
            poses.append(clock - due)
            waits += spent
            if len(poses) in milestones:
                sizes.append(process_stats().rss_mb - idle)
    tasks["snapshot"] += [timed(host.snapshot, name) for name in names]
    return {
        "kernel": kernel,
        "log": log,
        "instances": robots,
        "frames": len(calls),
        "scans_per_s": len(poses) / waits,
        "latency_ms": quantiles(poses),
        "map_ms": quantiles(tasks["news"]),
        "snapshot_ms": max(tasks["snapshot"]) * 1e3,
        "mb": {"idle": idle, "more": peak.mb() - idle, "each": (peak.mb() - idle) / robots, "on_the_way": sizes},
    }


def schedule(stamps: list[float], names: list[str]) -> Iterator[tuple[float, str, int | str]]:
    """(due s, robot, number of the frame or what else the host is asked for), in the order of time."""

    def of(name: str, start: float) -> Iterator[tuple[float, str, int | str]]:
        ticks = {what: start + every_s for what, every_s in ASKED.items()}
        for number, stamp in enumerate(np.maximum.accumulate(np.array(stamps) - stamps[0]) + start):
            for what, every_s in ASKED.items():
                while ticks[what] < stamp:
                    yield ticks[what], name, what
                    ticks[what] += every_s
            yield float(stamp), name, number

    return heapq.merge(*(of(name, number * APART_S) for number, name in enumerate(names)), key=lambda call: call[0])


def packed(log: str) -> tuple[list[float], list[bytes]]:
    """Stamps and encoded frames of a log."""
    frames = [pack(sweep, "robot", "0" * 32, seq) for seq, sweep in enumerate(sweeps(log))]
    return [frame.stamp for frame in frames], [encode(frame) for frame in frames]


def timed(call: Callable[..., Any], *arguments: Any) -> float:
    begin = time.process_time()
    call(*arguments)
    return time.process_time() - begin


def quantiles(seconds: list[float]) -> dict[str, float]:
    found = np.percentile(np.array(seconds) * 1e3, [50, 95, 99, 100])
    return dict(zip(("p50", "p95", "p99", "max"), found.tolist(), strict=True))


class Peak:
    """The most memory that this process has had since this was made."""

    def __init__(self) -> None:
        Path("/proc/self/clear_refs").write_text("5")  # forgets the peak of the start, when the log was read

    def mb(self) -> float:
        status = Path("/proc/self/status").read_text().splitlines()
        return next(int(row.split()[1]) for row in status if row.startswith("VmHWM")) / 1024


async def ready(kernel: str, workers: int) -> list[float]:
    """s until each worker of an edge could take a robot: the first from the start of the edge's template on."""
    out = []
    begin = time.perf_counter()
    template = await Template.start(TARGET, kernel=kernel)
    try:
        for _ in range(workers):
            worker = await template.fork()
            await worker.ready()
            out.append(time.perf_counter() - begin)
            await worker.close()
            begin = time.perf_counter()
    finally:
        await template.close()
    return out


def ready_line(kernel: str, seconds: list[float]) -> str:
    others = seconds[1:] or seconds
    return (
        f"{kernel:8s} the first worker ready after {seconds[0]:.2f} s, another one after {median(others) * 1e3:.0f} ms "
        f"({min(others) * 1e3:.0f} to {max(others) * 1e3:.0f})"
    )


def line(row: dict[str, Any]) -> str:
    mb, latency, maps = row["mb"], row["latency_ms"], row["map_ms"]
    grown = " / ".join(f"{size:.0f}" for size in mb["on_the_way"])
    return (
        f"{row['kernel']:8s} {row['log']:12s} {row['instances']} robots  idle {mb['idle']:.0f} MB, each "
        f"{mb['each']:.0f} MB more at most (all {grown} on the way)  pose after {latency['p50']:.1f} / "
        f"{latency['p95']:.1f} / {latency['p99']:.1f} / {latency['max']:.0f} ms  map {maps['p50']:.1f} / "
        f"{maps['p99']:.1f} / {maps['max']:.0f} ms  snapshot {row['snapshot_ms']:.0f} ms  "
        f"{row['scans_per_s']:.0f} scans/s"
    )


if __name__ == "__main__":
    main()
