"""A router of its own, for clusters over several hosts or containers."""

from __future__ import annotations

import asyncio
import logging

from common.bus import Router

log = logging.getLogger(__name__)


async def serve(stop: asyncio.Event, listen: str) -> None:
    """Route until `stop` is set. Raises UsageError when it cannot listen there."""
    async with await Router.open(listen) as router:
        log.info("routing", extra={"endpoint": router.endpoint})
        await stop.wait()
