"""Zenoh configurations of routers and services. Zenoh refuses unknown fields, so a misspelt one fails at the start."""

from __future__ import annotations

import json
import re
from typing import Any

import zenoh

MAX_TRANSPORT_BYTES = 64 * 1024 * 1024
"""Zenoh cuts off a peer that sends more in one message; what is between our own limit and this is refused by name."""

LINK: dict[str, Any] = {
    "tx": {
        "lease": 3000,  # announced by whoever may freeze: it is its own lease after which it is missed
        "keep_alive": 4,
        "queue": {
            "congestion_control": {
                "drop": {"wait_before_drop": 1000, "max_wait_before_drop_fragments": 200_000},
                # a reader that takes nothing for a second is cut off; the default stalls all others for five
                "block": {"wait_before_close": 1_000_000},
            }
        },
    },
    "rx": {"max_message_size": MAX_TRANSPORT_BYTES},
}

COMMON: dict[str, Any] = {
    "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
    "timestamping": {"enabled": True},  # cached samples carry no time otherwise
}


def node_config(endpoint: str, *, name: str, role: str, connect_s: float) -> zenoh.Config:
    """A client of the router at `endpoint`: no discovery, no shared memory, endless reconnection once it was open."""
    return _config(
        {
            **COMMON,
            "mode": "client",
            "metadata": {"name": name, "role": role},
            "connect": {
                "endpoints": [endpoint],
                # finite: an endless one would pin a thread that cannot be cancelled
                "timeout_ms": max(1, round(connect_s * 1000)),
                "exit_on_failure": True,
                "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5},
            },
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"shared_memory": {"enabled": False}, "link": LINK},
        }
    )


def router_config(listen: str, *, name: str) -> zenoh.Config:
    """A router that listens on `listen` and finds nobody by itself."""
    return _config(
        {
            **COMMON,
            "mode": "router",
            "metadata": {"name": name},
            "listen": {"endpoints": [listen]},
            "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {
                "unicast": {"max_sessions": 1000, "open_timeout": 5000, "accept_timeout": 5000},
                "shared_memory": {"enabled": False},
                "link": LINK,
            },
        }
    )


def said(error: zenoh.ZError) -> str:
    """What Zenoh says, without the places in its own source."""
    return re.sub(r" at \S+\.rs:\d+\.?", "", str(error))


def _config(fields: dict[str, Any]) -> zenoh.Config:
    return zenoh.Config.from_json5(json.dumps(fields))
