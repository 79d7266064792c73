"""What it costs to keep a SLAM instance every 1000 frames, and how soon it is back where it was when it was lost.

    RECSLAM_DATA=... python -m bench.checkpoints [--kernel graph] [--log intel_dense]

CPU seconds of one process. "kept" is the snapshot and the file, as a share of all SLAM; "back" the time until an
instance that was lost just before its next checkpoint, the worst moment, has taken every frame again.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from pathlib import Path

from bench.slam import sweeps
from common.wire import encode
from services.edge_worker.checkpoint import Checkpoint, Keeping
from services.edge_worker.checkpoints import Kept, OnDisk
from services.edge_worker.slam.host import SlamHost
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack

STREAM = "0" * 32


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kernel", action="append", choices=["graph", "gmapping"])
    parser.add_argument("--log", action="append")
    arguments = parser.parse_args()
    warmup()
    for log in arguments.log or ["intel_dense"]:
        frames = [encode(pack(sweep, "r1", STREAM, seq)) for seq, sweep in enumerate(sweeps(log))]
        for kernel in arguments.kernel or ["graph", "gmapping"]:
            with tempfile.TemporaryDirectory() as folder:
                print(f"{kernel:8s} {log}: {measured(kernel, frames, Path(folder))}", flush=True)


def measured(kernel: str, frames: list[bytes], folder: Path) -> str:
    store, every = OnDisk(folder), Keeping().frames
    host = opened(kernel)
    spent: list[float] = []
    keeping: list[float] = []
    for seq, data in enumerate(frames):
        begin = time.process_time()
        host.process("r1", data)
        spent.append(time.process_time() - begin)
        if seq % every == every - 1:
            begin = time.process_time()
            kept = Kept(Checkpoint(STREAM, seq, 0, 0), host.snapshot("r1"))
            asyncio.run(store.keep("r1", kept))
            keeping.append(time.process_time() - begin)
    begin = time.process_time()
    (newest, *_), _ = asyncio.run(store.newest("r1", STREAM))
    opened(kernel, newest.snapshot).news("r1")
    restoring = time.process_time() - begin
    tail = sum(spent[newest.checkpoint.seq - every + 1 : newest.checkpoint.seq + 1])
    return (
        f"{len(frames)} frames; SLAM {sum(spent):.1f} s; "
        f"kept {len(keeping)} times in {max(keeping) * 1e3:.0f} ms at most, {sum(keeping) / sum(spent):.1%}; "
        f"back in {restoring + tail:.1f} s ({restoring * 1e3:.0f} ms to restore) "
        f"instead of {sum(spent):.1f} s"
    )


def opened(kernel: str, snapshot: bytes | None = None) -> SlamHost:
    host = SlamHost()
    host.open("r1", 1, kernel, {}, seed=0, snapshot=snapshot)
    return host


if __name__ == "__main__":
    main()
