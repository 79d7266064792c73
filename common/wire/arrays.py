"""Numpy arrays inside messages: `Annotated[np.ndarray, ArrayOf("float64", columns=4)]`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import core_schema

EXT_ARRAY = 1
DTYPES = {"u1": "uint8", "i1": "int8", "u2": "uint16", "i4": "int32", "i8": "int64", "f4": "float32", "f8": "float64"}


@dataclass(frozen=True)
class ArrayOf:
    """Validates an array's dtype, number of columns (None: one-dimensional) and number of rows."""

    dtype: str
    columns: int | None = None
    max_rows: int = 65_536

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self.check, serialization=core_schema.plain_serializer_function_ser_schema(lambda a: a.tolist())
        )

    def check(self, value: Any) -> np.ndarray:
        if not isinstance(value, np.ndarray):
            raise ValueError(f"expected an array of {self.dtype}, got {type(value).__name__}")
        if value.dtype != np.dtype(self.dtype):
            raise ValueError(f"expected an array of {self.dtype}, got {value.dtype}")
        shape_ok = value.ndim == 1 if self.columns is None else value.ndim == 2 and value.shape[1] == self.columns
        if not shape_ok:
            wanted = "(n,)" if self.columns is None else f"(n, {self.columns})"
            raise ValueError(f"expected shape {wanted}, got {value.shape}")
        if len(value) > self.max_rows:
            raise ValueError(f"{len(value)} rows, more than the limit of {self.max_rows}")
        return value


def pack_array(value: np.ndarray) -> msgpack.ExtType:
    """dtype code (2 bytes), number of dimensions (1 byte), sizes (uint32 little endian each), C-order data."""
    code = value.dtype.str[1:]
    if code not in DTYPES:
        raise TypeError(f"arrays of {value.dtype} do not travel")
    head = code.encode() + bytes([value.ndim]) + np.array(value.shape, "<u4").tobytes()
    return msgpack.ExtType(EXT_ARRAY, head + np.ascontiguousarray(value).tobytes())


def unpack_array(data: bytes) -> np.ndarray:
    """The inverse of `pack_array`; the result is read-only. Raises ValueError on anything malformed."""
    code, ndim = data[:2].decode("ascii", "replace"), data[2] if len(data) > 2 else 0
    if code not in DTYPES or not 1 <= ndim <= 3 or len(data) < 3 + 4 * ndim:
        raise ValueError("malformed array header")
    shape = tuple(int(n) for n in np.frombuffer(data, "<u4", ndim, offset=3))
    dtype = np.dtype("<" + code)
    size = dtype.itemsize
    for n in shape:
        size *= n
    if size != len(data) - 3 - 4 * ndim:
        raise ValueError(f"array of shape {shape} wants {size} bytes, got {len(data) - 3 - 4 * ndim}")
    return np.frombuffer(data, dtype, offset=3 + 4 * ndim).reshape(shape)
