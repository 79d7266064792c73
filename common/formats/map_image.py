"""Images of maps: how bright each pixel is, from PGM by our own hand and from anything else by OpenCV."""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile

_GAP = rb"(?:\s+|#[^\r\n]*[\r\n])+"
_PGM_HEADER = re.compile(rb"P5" + _GAP + rb"(\d+)" + _GAP + rb"(\d+)" + _GAP + rb"(\d+)(?:#[^\r\n]*[\r\n]|\s)")
MAX_PIXELS = 1 << 28
"""A header that announces more is taken for broken."""


def write_pgm(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write uint8 (height, width), row 0 on top, as binary PGM."""
    height, width = pixels.shape
    path.write_bytes(f"P5\n{width} {height}\n255\n".encode() + np.ascontiguousarray(pixels, np.uint8).tobytes())


def read_channels(path: Path) -> NDArray[np.float64]:
    """Colour channels and, if the image has one, alpha: (height, width, 1, 3 or 4) in 0..1, row 0 on top.

    Channels stand as OpenCV reads them: grey, or blue green red, alpha last. Raises BadFile.
    """
    try:
        data = path.read_bytes()
        if data.startswith(b"\x1f\x8b"):
            data = gzip.decompress(data)
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise BadFile(f"{path}: cannot be read: {error}") from error
    return _parse_pgm(path, data) if data.startswith(b"P5") else _decode(path, data)


def _parse_pgm(path: Path, data: bytes) -> NDArray[np.float64]:
    header = _PGM_HEADER.match(data)
    if header is None:
        raise BadFile(f"{path}: no width, height and maximum follow the PGM mark P5; save the image again")
    width, height, maximum = (int(field[:10]) for field in header.groups())
    if not 0 < maximum < 65536 or not 0 < width * height <= MAX_PIXELS:
        raise BadFile(f"{path}: PGM header says {width} x {height}, maximum {maximum}")
    dtype: np.dtype[Any] = np.dtype(np.uint8 if maximum < 256 else ">u2")
    size = width * height * dtype.itemsize
    if len(data) - header.end() < size:
        raise BadFile(f"{path}: cut short: {len(data) - header.end()} of {size} bytes of pixels are there")
    pixels = np.frombuffer(data, dtype, width * height, header.end()).reshape(height, width, 1)
    return np.asarray(pixels / float(maximum))


def _decode(path: Path, data: bytes) -> NDArray[np.float64]:
    import cv2  # only here: a PGM is read without it

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise BadFile(f"{path}: no image that can be decoded; PGM and PNG can")
    return np.asarray(np.atleast_3d(image) / (255.0 if image.dtype == np.uint8 else 65535.0))
