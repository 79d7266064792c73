"""The only place that imports Zenoh: the asyncio bridge, the embedded router, the key expressions."""

from common.bus import keys
from common.bus.bus import Bus
from common.bus.events import Alive, Link
from common.bus.intake import Counters, Received
from common.bus.router import Router
from common.bus.stream import Stream

__all__ = ["Alive", "Bus", "Counters", "Link", "Received", "Router", "Stream", "keys"]
