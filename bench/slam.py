"""Speed, memory and accuracy of the SLAM kernels on real logs and simulated robots.

    RECSLAM_DATA=... python -m bench.slam [--kernel graph|gmapping] [--log intel_dense|aces|csail|SCENE:LIDAR[:SENSORS]]
        [--seeds 5]

Each run is a process of its own, so that its memory is its own. The map is asked for after each `MAP_EVERY` frames, as
a worker would; that time is stated apart. CPU time throughout. SENSORS is `all`, `imu` (no wheels) or `laser`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.evaluation.maps import wall_thickness
from common.evaluation.relations import read_odometry, read_relations, score_relations
from common.evaluation.trajectory import absolute_error
from common.formats.carmen import CarmenLog
from common.formats.picture import write_png
from common.formats.tum import write_trajectory
from common.sim import SimulatedRobot, load_scene
from common.sweep import Sweep
from common.wire import Frame
from services.edge_worker.slam.kernel import Kernel
from services.edge_worker.slam.registry import create
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack

LOGS = {
    "intel_dense": ("logs/intel_dense.raw.log.gz", "reference/intel.ref.txt.gz"),
    "aces": ("logs/aces.raw.log.gz", "reference/aces.ref.txt.gz"),
    "csail": ("logs/mit-csail.clf.gz", "reference/csail.ref.txt.gz"),
}
SCENES = (
    "apartment:rplidar_a1",
    "apartment:rplidar_a1:imu",
    "apartment:lds01",
    "apartment:lds01:imu",
    "factory:rplidar_a1",
)
RELATIONS = "relations/intel.relations.gz"
STRICT_S = 1e-4
"""s; relations whose both ends are frames of ours by their stamps, digit for digit"""
MAP_EVERY = 20
SCENE_S = 180.0
OUT = Path("results")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kernel", action="append", choices=["graph", "gmapping"])
    parser.add_argument("--log", action="append")
    parser.add_argument("--seeds", type=int, metavar="N", help="seeds 1 to N instead of 0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--here", action="store_true", help="run in this process and print JSON")
    arguments = parser.parse_args()
    kernels, logs = arguments.kernel or ["graph", "gmapping"], arguments.log or [*LOGS, *SCENES]
    if arguments.here:
        print(json.dumps(measure(kernels[0], logs[0], arguments.seed)))
        return
    if any(log in LOGS for log in logs):
        data()
    warmup()
    seeds = range(1, arguments.seeds + 1) if arguments.seeds else [arguments.seed]
    rows = []
    for log, kernel, seed in product(logs, kernels, seeds):
        command = [sys.executable, "-m", "bench.slam", "--here", "--kernel", kernel, "--log", log, "--seed", str(seed)]
        rows.append(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))
        print(line(rows[-1]), flush=True)
    (OUT / "slam.json").write_text(json.dumps(rows, indent=1))


def measure(kernel_name: str, log: str, seed: int = 0) -> dict[str, Any]:
    """Everything there is to say about one kernel on one log; writes the map and the trajectory to results/."""
    warmup()
    frames = [pack(sweep, "robot", "0" * 32, seq) for seq, sweep in enumerate(sweeps(log))]
    idle = peak_mb()
    kernel = create(kernel_name, {}, seed)
    spent, drawing = [], 0.0
    for frame in frames:
        spent.append(timed(kernel, frame))
        if frame.seq % MAP_EVERY == 0:
            begin = time.process_time()
            kernel.map()
            drawing += time.process_time() - begin
    begin = time.process_time()
    kernel.finish()
    finish = time.process_time() - begin
    begin = time.process_time()
    snapshot = kernel.snapshot()
    snapshot_s = time.process_time() - begin
    milliseconds = np.array(spent) * 1e3
    return {
        "kernel": kernel_name,
        "log": log,
        "seed": seed,
        "scans": len(frames),
        "ms": dict(zip(("p50", "p95", "p99", "max"), np.percentile(milliseconds, [50, 95, 99, 100]), strict=True)),
        "scans_per_s": len(frames) / (sum(spent) + finish),
        "map_s": drawing,
        "finish_s": finish,
        "snapshot": {"mb": len(snapshot) / 1e6, "ms": snapshot_s * 1e3},
        "rss_mb": {"idle": idle, "more": peak_mb() - idle},
        **keep(kernel, f"slam-{kernel_name}-{log.replace(':', '-')}-{seed}".removesuffix("-0")),
        "accuracy": accuracy(kernel.trajectory(), log),
    }


def timed(kernel: Kernel, frame: Frame) -> float:
    begin = time.process_time()
    kernel.process(frame)
    return time.process_time() - begin


def sweeps(log: str) -> Iterator[Sweep]:
    if log in LOGS:
        yield from CarmenLog(data() / LOGS[log][0])
    else:
        yield from robot(log).sweeps()


def robot(log: str) -> SimulatedRobot:
    """The simulated robot that `SCENE:LIDAR[:SENSORS]` names."""
    scene, lidar, sensors = [*log.split(":"), "all"][:3]
    return SimulatedRobot(
        load_scene(scene),
        "r1",
        1,
        lidar=lidar,
        duration_s=SCENE_S,
        imu=sensors in ("all", "imu"),
        wheels=sensors == "all",
    )


def accuracy(trajectory: NDArray[np.float64], log: str) -> dict[str, float]:
    """Metres: against relations where there are some, the reference of the log, or the simulator's truth."""
    if log not in LOGS:
        truth = robot(log).poses(trajectory[:, 0])
        error = absolute_error([trajectory], [np.column_stack([trajectory[:, 0], truth])])
        return {"ate": error.rmse, "max": error.max, "degrees": float(np.degrees(error.rotation_mean))}
    error = absolute_error([trajectory], [np.loadtxt(data() / LOGS[log][1])])
    out = {"ate_to_reference": error.rmse}
    if log == "intel_dense":
        relations, odometry = read_relations(data() / RELATIONS), read_odometry(data() / LOGS[log][0])
        score = score_relations(relations, odometry, [trajectory])
        strict = score_relations(relations, odometry, [trajectory], exact_s=STRICT_S).stats(exact=True)
        every, exact = score.stats(), score.stats(exact=True)
        out |= {"all": every.translation, "all_sd": every.translation_sd, "all_n": every.n}
        out |= {"exact": exact.translation, "exact_sd": exact.translation_sd, "exact_n": exact.n}
        out |= {"strict": strict.translation, "strict_sd": strict.translation_sd, "strict_n": strict.n}
        out["unscored"] = score.unscored
    return out


def keep(kernel: Kernel, name: str) -> dict[str, Any]:
    """Write map and trajectory; returns what is to be said of the map."""
    OUT.mkdir(exist_ok=True)
    grid, trajectory = kernel.map(), kernel.trajectory()
    occupancy, (x0, y0) = grid.occupancy()
    origin = (x0 * grid.resolution, y0 * grid.resolution, 0.0)
    write_png(OUT / f"{name}.png", occupancy, grid.resolution, origin, {"robot": trajectory})
    write_trajectory(OUT / f"{name}.tum", trajectory)
    return {"digest": grid.digest(), "wall_cells": wall_thickness(occupancy)}


def line(row: dict[str, Any]) -> str:
    ms, rss = row["ms"], row["rss_mb"]
    errors = " ".join(
        f"{name} {value:.4f}" for name, value in row["accuracy"].items() if not name.endswith(("_sd", "_n"))
    )
    return (
        f"{row['kernel']:8s} {row['log']:26s} seed {row['seed']} {row['scans']:5d} scans  "
        f"{ms['p50']:6.2f} / {ms['p95']:6.2f} / {ms['p99']:6.2f} ms  {row['scans_per_s']:5.0f} scans/s  "
        f"map {row['map_s']:5.2f} s  RSS {rss['idle']:.0f} + {rss['more']:.0f} MB  "
        f"snapshot {row['snapshot']['mb']:.1f} MB {row['snapshot']['ms']:.0f} ms  {errors}"
    )


def data() -> Path:
    """Where the real logs are. Ends the program when nobody said."""
    if "RECSLAM_DATA" not in os.environ:
        raise SystemExit("set RECSLAM_DATA to the folder of the real logs, or name scenes with --log")
    return Path(os.environ["RECSLAM_DATA"])


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
