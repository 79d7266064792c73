"""A router that is a process of its own and can be killed: `python router_process.py LISTEN`."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from common.bus import Router


@contextmanager
def router_process(listen: str = "tcp/127.0.0.1:0") -> Iterator[str]:
    """Where it listens; it dies by kill -9 at the block's end."""
    command = [sys.executable, __file__, listen]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.kill()


async def _main() -> None:
    async with await Router.open(sys.argv[1]) as router:
        print(router.endpoint, flush=True)
        await asyncio.to_thread(sys.stdin.read)


if __name__ == "__main__":
    asyncio.run(_main())
