"""Hypothesis strategies for any message, read off the models' own fields."""

from __future__ import annotations

import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from common.wire.arrays import ArrayOf
from common.wire.cloud import Warp
from common.wire.codec import KINDS

MAX_SIZE = 4
INT64 = 2**63


def messages() -> st.SearchStrategy[BaseModel]:
    return st.one_of([model(kind) for kind in KINDS.values()])


def model(kind: type[BaseModel]) -> st.SearchStrategy[BaseModel]:
    if kind is Warp:
        return warps()
    fields = {name: value(field.annotation, field.metadata) for name, field in kind.model_fields.items()}
    return st.builds(kind, **fields)


@st.composite
def warps(draw: st.DrawFn) -> Warp:
    """Warps, whose fields must fit together."""
    columns, rows = draw(st.integers(2, MAX_SIZE)), draw(st.integers(2, MAX_SIZE))
    size = 2 * columns * rows
    shifts = draw(st.lists(st.integers(-10_000_000, 10_000_000), min_size=size, max_size=size))
    x, y = draw(st.integers(-100_000, 100_000)), draw(st.integers(-100_000, 100_000))
    return Warp(spacing_m=draw(st.floats(0.5, 50)), x=x, y=y, columns=columns, shifts_um=tuple(shifts))


def value(annotation: Any, metadata: list[Any]) -> st.SearchStrategy[Any]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return value(arguments[0], [*flat(arguments[1:]), *metadata])
    if origin in (Union, types.UnionType):
        return st.one_of([value(one, metadata) for one in arguments])
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(value(arguments[0], []), max_size=MAX_SIZE).map(tuple)
    if origin is tuple:
        return st.tuples(*[value(one, []) for one in arguments])
    if origin is dict:
        return st.dictionaries(value(arguments[0], []), value(arguments[1], []), max_size=MAX_SIZE)
    if annotation is np.ndarray:
        return array(next(one for one in metadata if isinstance(one, ArrayOf)))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return model(annotation)
    return plain(annotation, limits(metadata))


def flat(metadata: Any) -> list[Any]:
    return [part for one in metadata for part in (one.metadata if isinstance(one, FieldInfo) else [one])]


def limits(metadata: list[Any]) -> dict[str, Any]:
    """Bounds and pattern of a field by their names in annotated_types."""
    found: dict[str, Any] = {}
    for one in metadata:
        for name in ("ge", "gt", "le", "lt", "max_length", "pattern"):
            if getattr(one, name, None) is not None:
                found[name] = getattr(one, name)
        if isinstance(one, annotated_types.MaxLen):
            found["max_length"] = one.max_length
    return found


def plain(kind: Any, bound: dict[str, Any]) -> st.SearchStrategy[Any]:
    if kind is types.NoneType:
        return st.none()
    if kind is bool:
        return st.booleans()
    if kind is int:
        return st.integers(bound.get("ge", -INT64), bound.get("le", INT64 - 1))
    if kind is float:
        low, high = bound.get("ge", bound.get("gt")), bound.get("le", bound.get("lt"))
        return st.floats(low, high, allow_nan=False, allow_infinity=False, exclude_min="gt" in bound)
    if kind is bytes:
        return st.binary(max_size=64)
    if kind is str and "pattern" in bound:
        return st.from_regex(bound["pattern"], fullmatch=True).filter(lambda text: "\n" not in text)
    if kind is str:
        return st.text(max_size=min(32, bound.get("max_length", 32)))
    raise TypeError(f"no strategy for {kind}")


def array(of: ArrayOf) -> st.SearchStrategy[np.ndarray]:
    shape = st.tuples(st.integers(0, 5)) if of.columns is None else st.tuples(st.integers(0, 5), st.just(of.columns))
    return hnp.arrays(of.dtype, shape)
