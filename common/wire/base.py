"""What all messages have in common."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core.core_schema import CoreSchema

from common.wire.limits import NAME_PATTERN

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
"""A robot's or an edge's name."""

StreamId = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
"""uuid of the spool that numbered the frames: a wiped spool or a second robot of one name is seen by it."""

Epoch = tuple[int, int]
"""(term, n): the scheduler's term and its count within it; later epochs compare greater."""

PoseTuple = tuple[float, float, float]
"""x, y in metres, theta in radians."""


def _stop_at_first_fault(schema: Any) -> None:
    """In every list and mapping of the schema: to tell a million faults of one message would take gigabytes."""
    if isinstance(schema, dict):
        if schema.get("type") in ("dict", "tuple"):
            schema["fail_fast"] = True
        for inner in schema.values():
            _stop_at_first_fault(inner)
    elif isinstance(schema, list):
        for inner in schema:
            _stop_at_first_fault(inner)


class Part(BaseModel):
    """A piece of a message: immutable and strict about its fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        _stop_at_first_fault(schema)
        return schema


class Message(Part):
    """Something that travels alone under a key."""


class Cover(Part):
    """How much of a robot's stream a derived product contains."""

    stream: StreamId
    seq: int
    """last frame contained"""
    epoch: Epoch
    """routing epoch of the instance that made it"""
    corrections: int = 0
    """how often SLAM has moved what the robot's map had shown before"""
    corrected_m: float = 0.0
    """by how much at most the last time, metres"""


Covers = dict[Name, Cover]
