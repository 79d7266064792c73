"""The command line of an edge worker."""

from __future__ import annotations

import argparse
import asyncio
import os
from collections.abc import Sequence

from common.fusion.check import check
from common.service import arguments, load_fleet, open_bus, run
from services.edge_worker.service import EdgeWorker
from services.edge_worker.slam.registry import create


def main(argv: Sequence[str] | None = None) -> int:
    """Run one edge until it is stopped; the exit code is for `sys.exit`."""
    parser = arguments("edge_worker", "Run SLAM for the robots routed here, and fuse their maps.")
    parser.add_argument("--id", required=True, help="name of the edge")
    args = parser.parse_args(argv)
    return run(lambda stop: _edge(args, stop), f"edge/{args.id}", args.log_format, args.log_level)


async def _edge(args: argparse.Namespace, stop: asyncio.Event) -> None:
    fleet = load_fleet(args)
    check(fleet)
    create(fleet.slam.kernel, fleet.slam.settings, fleet.seed)  # refuses settings before anything is started
    workers = fleet.edge.workers or os.cpu_count() or 1
    async with await open_bus(fleet, args.id, "edge") as bus:
        await EdgeWorker(fleet, args.id, bus, workers, stop).run()
