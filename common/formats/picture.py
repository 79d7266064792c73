"""Pictures for people: an occupancy map as PNG, with robots' ways and names drawn in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import UsageError
from common.geometry import apply, inverse
from common.wire.base import PoseTuple

UNKNOWN, FREE, WALL = 160, 255, 0
COLOURS = (
    (180, 119, 31), (14, 127, 255), (44, 160, 44), (40, 39, 214), (189, 103, 148),
    (75, 86, 140), (194, 119, 227), (34, 189, 188), (207, 190, 23), (80, 60, 20),
)  # fmt: skip
"""blue green red, told apart on white; robots take them in the order of their names"""
SUBPIXEL_BITS = 4


def draw_map(
    occupancy: NDArray[np.int8],
    resolution: float,
    origin: PoseTuple = (0.0, 0.0, 0.0),
    trajectories: Mapping[str, ArrayLike] | None = None,
    scale: int = 1,
) -> NDArray[np.uint8]:
    """An image, uint8 (height * scale, width * scale, 3) blue green red, y up: white free, black walls, grey unknown.

    `occupancy`, `resolution` and `origin` as in SavedMap; between free and occupied, the more occupied the darker.
    `trajectories` maps robots' names to (n, 3) x, y, theta or (n, 4) stamp, x, y, theta in the map frame; they are
    drawn over the map, with a dot and the name at their ends. Rows that are not finite interrupt a line.
    """
    cells = np.asarray(occupancy)[::-1].astype(np.int16)
    grey = np.where(cells < 0, UNKNOWN, FREE + (WALL - FREE) * np.clip(cells, 0, 100) // 100).astype(np.uint8)
    image = np.repeat(np.repeat(grey, scale, axis=0), scale, axis=1)[..., None].repeat(3, axis=2)
    per_metre = scale / resolution
    for index, name in enumerate(sorted(trajectories or {})):
        points = np.asarray((trajectories or {})[name], np.float64)
        if points.ndim != 2 or points.shape[1] not in (3, 4):
            raise UsageError(f"trajectory of {name}: shape {points.shape} is neither (n, 3) nor (n, 4)")
        in_map = apply(inverse(origin), points[:, -3:-1]) * per_metre
        pixels = np.column_stack([in_map[:, 0], len(image) - in_map[:, 1]]) - 0.5
        _draw_way(image, pixels, name, COLOURS[index % len(COLOURS)], scale)
    return image


def write_png(
    path: str | Path,
    occupancy: NDArray[np.int8],
    resolution: float,
    origin: PoseTuple = (0.0, 0.0, 0.0),
    trajectories: Mapping[str, ArrayLike] | None = None,
    scale: int = 1,
) -> None:
    """Write what `draw_map` draws as PNG, making the folder."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_bytes(encode_png(draw_map(occupancy, resolution, origin, trajectories, scale)))


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """A PNG file of an image, (height, width) grey or (height, width, 3) blue green red."""
    import cv2  # only here: importing this module costs nothing

    done, data = cv2.imencode(".png", image)
    if not done:
        raise UsageError(f"an image of shape {image.shape} cannot be written as PNG")
    return bytes(data.tobytes())


def _draw_way(
    image: NDArray[np.uint8], pixels: NDArray[np.float64], name: str, colour: tuple[int, int, int], scale: int
) -> None:
    import cv2

    finite = np.asarray(np.isfinite(pixels).all(axis=1))
    runs = np.split(np.arange(len(pixels)), np.flatnonzero(np.diff(finite)) + 1)
    ways = [pixels[run] for run in runs if len(run) and finite[run[0]]]
    # OpenCV's fixed-point coordinates are 32 bits: far outside is as good as farther.
    limit = 8 * max(image.shape)
    fixed = [np.rint(np.clip(way, -limit, limit) * (1 << SUBPIXEL_BITS)).astype(np.int32) for way in ways]
    cv2.polylines(image, fixed, False, colour, max(1, scale // 2), cv2.LINE_AA, SUBPIXEL_BITS)
    if ways:
        x, y = (int(v) for v in np.rint(np.clip(ways[-1][-1], -limit, limit)))
        cv2.circle(image, (x, y), 2 + scale, colour, cv2.FILLED, cv2.LINE_AA)
        size = 0.35 + 0.1 * scale
        cv2.putText(image, name, (x + 4 + scale, y - 2), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
