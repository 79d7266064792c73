"""The command line of the scheduler."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence

from common.errors import ConfigError
from common.service import arguments, load_fleet, open_bus, run
from services.scheduler.policies import POLICIES
from services.scheduler.service import Scheduler


def main(argv: Sequence[str] | None = None) -> int:
    """Run the scheduler until it is stopped; the exit code is for `sys.exit`."""
    args = arguments("scheduler", "Group robots over the edges and push routing tables.").parse_args(argv)
    return run(lambda stop: _scheduler(args, stop), "scheduler", args.log_format, args.log_level)


async def _scheduler(args: argparse.Namespace, stop: asyncio.Event) -> None:
    fleet = load_fleet(args)
    if fleet.scheduler.policy not in POLICIES:
        known = ", ".join(POLICIES)
        raise ConfigError(f"scheduler.policy: {fleet.scheduler.policy!r} is unknown; choose one of {known}")
    async with await open_bus(fleet, "scheduler", "scheduler") as bus:
        await Scheduler(fleet, bus, stop).run()
