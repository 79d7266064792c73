"""Bytes on the wire: msgpack of `[version, kind, fields]`; arrays are extension type 1 (see arrays.py)."""

from __future__ import annotations

from reprlib import repr as short
from typing import Any

import msgpack
import numpy as np
from pydantic import BaseModel, ValidationError

from common.errors import BadMessage
from common.wire import cloud, edge, pages, robot, scheduler
from common.wire.arrays import EXT_ARRAY, pack_array, unpack_array
from common.wire.base import Message
from common.wire.limits import MAX_ITEMS, MAX_MESSAGE_BYTES, MAX_TEXT_BYTES, VERSION

AnyMessage = (
    robot.Frame
    | robot.EndOfStream
    | robot.RobotProfile
    | robot.RobotStatus
    | edge.Ack
    | edge.PoseUpdate
    | edge.MapNotice
    | edge.Verdicts
    | edge.EdgeMapNotice
    | edge.Claims
    | edge.EdgeStatus
    | cloud.Transforms
    | cloud.GlobalMapNotice
    | cloud.CloudStatus
    | scheduler.Routes
    | scheduler.OverlapMatrix
    | scheduler.Plan
    | scheduler.SchedulerStatus
    | pages.FramePage
    | pages.TilePage
    | pages.TrajectoryPage
    | pages.Refusal
)
"""The closed union of what travels; `match` on it."""

FAULTS = 8
"""faults of one message or file that are told; more are only counted"""

KINDS: dict[str, type[Message]] = {kind.__name__: kind for kind in AnyMessage.__args__}


def encode(message: Message) -> bytes:
    """The message as bytes. Raises BadMessage when it is larger than the wire allows, or holds what cannot travel."""
    kind = type(message).__name__
    if kind not in KINDS:
        raise BadMessage(f"{kind} is not a message that travels")
    try:
        data: bytes = msgpack.packb([VERSION, kind, plain(message)], default=_default)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"{kind} holds something that does not travel: {error}") from error
    if len(data) > MAX_MESSAGE_BYTES:
        raise BadMessage(f"{kind} of {len(data)} bytes is over the limit of {MAX_MESSAGE_BYTES}; send it in pages")
    return data


def decode(data: bytes, sender: str = "") -> Message:
    """The message in `data`. Raises BadMessage, which names the field and the sender, on anything else."""
    if len(data) > MAX_MESSAGE_BYTES:
        raise BadMessage(f"{len(data)} bytes are over the limit of {MAX_MESSAGE_BYTES}", sender)
    try:
        _walk(data)
        parts = msgpack.unpackb(
            data,
            ext_hook=_ext,
            use_list=False,
            max_array_len=min(MAX_ITEMS, len(data)),  # an item takes a byte at least
            max_map_len=min(MAX_ITEMS, len(data)),
            max_str_len=MAX_TEXT_BYTES,
            max_ext_len=MAX_MESSAGE_BYTES,
            max_bin_len=MAX_MESSAGE_BYTES,
        )
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise BadMessage(f"not msgpack of this protocol: {error}", sender) from error
    if not (isinstance(parts, tuple) and len(parts) == 3):
        raise BadMessage("not a [version, kind, fields] triple", sender)
    version, kind, fields = parts
    if version != VERSION or version is True:
        raise BadMessage(f"wire version {short(version)}, this program has {VERSION}; upgrade the older side", sender)
    if not isinstance(kind, str) or kind not in KINDS:
        raise BadMessage(f"unknown kind {short(kind)}", sender)
    try:
        return KINDS[kind].model_validate(fields)
    except ValidationError as error:
        raise BadMessage(f"{kind}: {explain(error)}", sender) from error


def explain(error: ValidationError) -> str:
    """`field: what is wrong` for the first faults, without pydantic's links."""
    faults = error.errors(include_url=False, include_context=False, include_input=False)
    told = [
        f"{'.'.join(str(part)[:64] for part in fault['loc']) or 'message'}: {fault['msg']}" for fault in faults[:FAULTS]
    ]
    return "; ".join(told) + (f"; and {len(faults) - FAULTS} more" if len(faults) > FAULTS else "")


def plain(value: Any) -> Any:
    """Models as dicts of their fields, all else as it is."""
    if isinstance(value, BaseModel):
        return {name: plain(field) for name, field in value.__dict__.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return value


def _walk(data: bytes) -> None:
    """Pass over the data without making anything of it. Raises what msgpack raises when its end is missing.

    An array's memory is taken when its length is read: a thousand within each other, none of them there to its end,
    would take half a gigabyte.
    """
    reader = msgpack.Unpacker(max_buffer_size=MAX_MESSAGE_BYTES)
    reader.feed(data)
    reader.skip()


def _default(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return pack_array(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not travel")


def _ext(code: int, data: bytes) -> Any:
    if code != EXT_ARRAY:
        raise ValueError(f"unknown extension type {code}")
    return unpack_array(data)
