"""Does a SLAM kernel that is restored from a snapshot end with the same map, bit for bit?

    RECSLAM_DATA=... python -m bench.slam_restore [--points 20] [--kernel graph] [--log intel_dense]

One run takes a snapshot at random frames; a new kernel then continues from each to the end of the log.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from bench.slam import sweeps
from common.wire import Frame
from services.edge_worker.slam.kernel import Kernel
from services.edge_worker.slam.registry import create
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=20)
    parser.add_argument("--kernel", action="append", choices=["graph", "gmapping"])
    parser.add_argument("--log", action="append")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    warmup()
    for log in arguments.log or ["intel_dense"]:
        frames = [pack(sweep, "robot", "0" * 32, seq) for seq, sweep in enumerate(sweeps(log))]
        for kernel in arguments.kernel or ["graph", "gmapping"]:
            print(f"{kernel:8s} {log}: {tried(kernel, frames, arguments.points, arguments.seed)}", flush=True)


def tried(name: str, frames: list[Frame], points: int, seed: int) -> str:
    """How many of the restored runs end like the one that was not disturbed, and what the snapshots took."""
    at = np.sort(np.random.default_rng(seed).choice(len(frames), points, replace=False))
    kernel, snapshots, spent = create(name, {}, seed), {}, []
    for frame in frames:
        if frame.seq in at:
            begin = time.process_time()
            snapshots[frame.seq] = kernel.snapshot()
            spent.append(time.process_time() - begin)
        kernel.process(frame)
    wanted = end(kernel)
    same = 0
    for seq, data in snapshots.items():
        kernel = create(name, {}, 0)
        kernel.restore(data)
        for frame in frames[seq:]:
            kernel.process(frame)
        same += end(kernel) == wanted
    largest = max(len(data) for data in snapshots.values()) / 1e6
    return f"{same} of {points} end the same; snapshots up to {largest:.1f} MB, {max(spent) * 1e3:.0f} ms"


def end(kernel: Kernel) -> tuple[str, bytes]:
    """Digest of the final map, and the trajectory."""
    kernel.finish()
    return kernel.map().digest(), kernel.trajectory().tobytes()


if __name__ == "__main__":
    main()
