"""The command line of the cloud merger."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence

from common.fusion.check import check
from common.service import arguments, load_fleet, open_bus, run
from services.cloud_merger.service import CloudMerger


def main(argv: Sequence[str] | None = None) -> int:
    """Run the cloud merger until it is stopped; the exit code is for `sys.exit`."""
    args = arguments("cloud_merger", "Merge edge maps into the global map.").parse_args(argv)
    return run(lambda stop: _cloud(args, stop), "cloud", args.log_format, args.log_level)


async def _cloud(args: argparse.Namespace, stop: asyncio.Event) -> None:
    fleet = load_fleet(args)
    check(fleet)
    async with await open_bus(fleet, "cloud", "cloud") as bus:
        await CloudMerger(fleet, bus, stop).run()
