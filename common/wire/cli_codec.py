"""Decoder plugin for zenoh-cli: `zenoh ... --decoder recslam` prints messages as readable JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from common.errors import BadMessage
from common.wire.codec import decode as decode_message
from common.wire.codec import plain

LONG = 8
"""arrays and byte strings longer than this are shown by their size"""


def decode(key: str, data: bytes) -> str:
    """One line of JSON for a message, or what is wrong with it."""
    try:
        message = decode_message(data, sender=key)
    except BadMessage as error:
        return json.dumps({"error": str(error)})
    return json.dumps({"message": type(message).__name__, **{k: _short(v) for k, v in plain(message).items()}})


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_short(item) for item in value]
    if isinstance(value, np.ndarray):
        if value.size > LONG:
            return f"<{value.dtype} {'x'.join(str(n) for n in value.shape)}>"
        return value.tolist()
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>" if len(value) > LONG else value.hex()
    if isinstance(value, float):
        return round(value, 6)
    return value
