"""The command line of a robot's agent."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence
from pathlib import Path

from common.service import arguments, load_fleet, run
from services.robot_agent.collector import Collector
from services.robot_agent.service import RobotAgent
from services.robot_agent.sources.factory import make
from services.robot_agent.spool import Spool


def main(argv: Sequence[str] | None = None) -> int:
    """Run one robot until it is stopped; the exit code is for `sys.exit`."""
    args = _parser().parse_args(argv)
    return run(lambda stop: _agent(args, stop), f"robot/{args.id}", args.log_format, args.log_level)


async def _agent(args: argparse.Namespace, stop: asyncio.Event) -> None:
    fleet = load_fleet(args)
    entry = fleet.robot_entry(args.id)
    limit = int(fleet.robot.spool_mb * 2**20)
    path = spool_path(args.spool, entry.id)
    with await asyncio.to_thread(Spool, path, entry.id, limit, fleet.robot.record) as spool:  # reads it through
        source = await asyncio.to_thread(make, entry, fleet)
        collector = Collector(source, spool, fleet.robot.lossless, args.realtime or fleet.robot.realtime)
        await RobotAgent(fleet, entry, collector, spool, stop, args.exit_when_processed).run()


def spool_path(folder: Path, robot: str) -> Path:
    """Where a robot's spool lies."""
    return folder / f"{robot}.spool"


def _parser() -> argparse.ArgumentParser:
    parser = arguments("robot_agent", "Collect, spool and stream the frames of one robot.")
    parser.add_argument("--id", required=True, help="name of the robot; its entry in the fleet file says its source")
    parser.add_argument("--spool", type=Path, default=Path("spool"), metavar="DIR", help="folder of spools (./spool)")
    parser.add_argument("--realtime", action="store_true", help="pace recorded and simulated sweeps by their stamps")
    parser.add_argument(
        "--exit-when-processed", action="store_true", help="stop once the edge has processed an ended stream"
    )
    return parser
