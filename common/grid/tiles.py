"""Tiles as bytes: zstd level 1 (the best ratio for the time on grid tiles) of the raw cells."""

from __future__ import annotations

import numpy as np
import zstandard
from numpy.typing import NDArray

from common.errors import BadMessage
from common.grid.grid import TILE, Counts

COUNT_BYTES = 2 * TILE * TILE * 2
OCCUPANCY_BYTES = TILE * TILE


def encode_counts(counts: Counts) -> bytes:
    """uint16 (2, 64, 64) as bytes; an emptied tile is empty."""
    return zstandard.ZstdCompressor(level=1).compress(counts.astype("<u2").tobytes()) if counts.any() else b""


def decode_counts(data: bytes, sender: str = "") -> Counts:
    """The inverse of `encode_counts`. Raises BadMessage when the bytes are no tile."""
    if not data:
        return np.zeros((2, TILE, TILE), np.uint16)
    cells = np.frombuffer(_inflate(data, COUNT_BYTES, sender), "<u2").reshape(2, TILE, TILE)
    if (cells[0] > cells[1]).any():
        raise BadMessage("tile counts more hits than visits", sender)
    return cells


def encode_occupancy(cells: NDArray[np.int8]) -> bytes:
    """int8 (64, 64) of -1, 0, 1, 100 as bytes; a wholly unknown tile is empty."""
    return zstandard.ZstdCompressor(level=1).compress(cells.tobytes()) if (cells != -1).any() else b""


def decode_occupancy(data: bytes, sender: str = "") -> NDArray[np.int8]:
    """The inverse of `encode_occupancy`. Raises BadMessage when the bytes are no tile."""
    if not data:
        return np.full((TILE, TILE), -1, np.int8)
    cells = np.frombuffer(_inflate(data, OCCUPANCY_BYTES, sender), np.int8).reshape(TILE, TILE)
    if not np.isin(cells, (-1, 0, 1, 100)).all():
        raise BadMessage("tile holds values other than -1, 0, 1 and 100", sender)
    return cells


def _inflate(data: bytes, size: int, sender: str) -> bytes:
    try:
        if zstandard.frame_content_size(data) != size:
            raise BadMessage(f"tile does not hold {size} bytes", sender)
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise BadMessage(f"tile is no zstd frame: {error}", sender) from error
