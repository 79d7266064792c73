"""map_server maps (ROS, Nav2): a yaml file of metadata beside an image.

Read by the rules of Nav2's map_server in its three modes, written in `trinary`. In memory the map is `occupancy`,
int8 (height, width), -1 unknown, 0 free, up to 100 occupied in percent, row 0 the lowest y; in the image row 0 is
the top. A pixel of brightness p counts as occupied by 1 - p, or by p when negated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile, UsageError
from common.formats.map_image import read_channels, write_pgm
from common.formats.text import numbered_lines
from common.wire.base import PoseTuple

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""As written. The unknown pixel reads as 0.1961 occupied: a free_thresh of 0.25 would turn it into free space."""
UNKNOWN_PIXEL, FREE_PIXEL, OCCUPIED_PIXEL = 205, 254, 0
FREE_UP_TO, OCCUPIED_FROM = 25, 65
"""percent; what lies between is written as unknown"""
REQUIRED = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")
MODES = ("trinary", "scale", "raw")
SWITCH = {"0": False, "1": True, "false": False, "true": True}


@dataclass(frozen=True)
class SavedMap:
    """An occupancy map and where it lies."""

    occupancy: NDArray[np.int8]
    """(height, width): -1 unknown, 0..100 percent occupied, row 0 the lowest y"""
    resolution: float
    """m per cell"""
    origin: PoseTuple = (0.0, 0.0, 0.0)
    """m, m, rad: pose in the map frame of the lower left corner of cell [0, 0]"""


def write_map(
    path: str | Path, occupancy: NDArray[np.int8], resolution: float, origin: PoseTuple = (0.0, 0.0, 0.0)
) -> Path:
    """Write `path`.yaml and `path`.pgm, making their folder; `path` may end in .yaml. Returns the yaml's path.

    Arguments as in SavedMap. Raises UsageError for what is no map.
    """
    cells = np.asarray(occupancy)
    if cells.ndim != 2 or 0 in cells.shape:
        raise UsageError(f"{path}: a map to write has a height and a width, this one has shape {cells.shape}")
    if not (resolution > 0 and all(math.isfinite(v) for v in (resolution, *origin))):
        raise UsageError(f"{path}: resolution {resolution} and origin {origin} must be finite, resolution positive")
    path = Path(path)
    name = path.stem if path.suffix == ".yaml" else path.name
    path.parent.mkdir(parents=True, exist_ok=True)
    write_pgm(path.with_name(f"{name}.pgm"), pixels_of(cells))
    x, y, yaw = (float(v) for v in origin)
    meta = path.with_name(f"{name}.yaml")
    meta.write_text(
        f'image: "{name}.pgm"\nmode: trinary\nresolution: {float(resolution)!r}\norigin: [{x!r}, {y!r}, {yaw!r}]\n'
        f"negate: 0\noccupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    return meta


def read_map(path: str | Path, image: Path | None = None) -> SavedMap:
    """The map whose yaml file is `path`; its image may be PGM (also gzipped), PNG or what else OpenCV knows.

    `image` takes the place of the one that the yaml names. Raises BadFile naming the file and what is wrong with it.
    """
    meta = Metadata(Path(path))
    resolution = meta.number("resolution")
    if resolution <= 0:
        raise BadFile(f"{path}: resolution {resolution} must be positive")
    cells = _interpret(meta, read_channels(image or meta.image()))
    return SavedMap(np.ascontiguousarray(cells[::-1]), resolution, meta.origin())


def pixels_of(occupancy: NDArray[np.int8]) -> NDArray[np.uint8]:
    """The image, uint8 (height, width) with row 0 on top, of an occupancy map."""
    cells = np.asarray(occupancy)[::-1]
    pixels = np.full(cells.shape, UNKNOWN_PIXEL, np.uint8)
    pixels[(cells >= 0) & (cells <= FREE_UP_TO)] = FREE_PIXEL
    pixels[cells >= OCCUPIED_FROM] = OCCUPIED_PIXEL
    return pixels


class Metadata:
    """The flat part of YAML that such files use: `key: value`, comments, quotes, and lists in either notation."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._values: dict[str, str] = {}
        key = ""
        for number, line in numbered_lines(path):
            text = line.split(" #")[0].strip()
            if text.startswith("- ") and key:
                self._values[key] += f",{text[2:]}"
                continue
            key, colon, value = text.partition(":")
            if not colon and text not in ("---", "..."):
                raise BadFile(f"{path}:{number}: expected `key: value`, got {line!r}")
            self._values[key.strip()] = value.strip().strip("\"'")
        missing = [name for name in REQUIRED if not self._values.get(name)]
        if missing:
            raise BadFile(f"{path}: lacks {', '.join(missing)}; is it the yaml file of a map?")

    def number(self, name: str) -> float:
        return self._numbers(name, 1)[0]

    def origin(self) -> PoseTuple:
        x, y, yaw = self._numbers("origin", 3)
        return x, y, yaw

    def negate(self) -> bool:
        text = self._values["negate"].lower()
        if text not in SWITCH:
            raise BadFile(f"{self.path}: negate is {text!r}; write 0 or 1")
        return SWITCH[text]

    def mode(self) -> str:
        mode = self._values.get("mode", "trinary").lower()
        if mode not in MODES:
            raise BadFile(f"{self.path}: mode {mode!r} is none of {', '.join(MODES)}")
        return mode

    def image(self) -> Path:
        """The image's path, which the file gives relative to itself; the same name with .gz is taken too."""
        path = self.path.parent / self._values["image"]
        try:
            zipped = path.with_name(path.name + ".gz")
            return zipped if zipped.exists() and not path.exists() else path
        except (OSError, ValueError) as error:
            raise BadFile(f"{self.path}: image {self._values['image'][:64]!r} is no file name: {error}") from error

    def _numbers(self, name: str, count: int) -> list[float]:
        text = self._values[name]
        try:
            numbers = [float(field) for field in text.strip("[], ").split(",")]
        except ValueError as error:
            raise BadFile(f"{self.path}: {name} is {text!r}: {error}") from error
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise BadFile(f"{self.path}: {name} is {text!r}; it takes {count} finite numbers")
        return numbers


def _interpret(meta: Metadata, channels: NDArray[np.float64]) -> NDArray[np.int8]:
    """Occupancy of an image's pixels, (height, width) with row 0 still on top."""
    mode = meta.mode()
    alpha = channels[..., -1] if channels.shape[-1] == 4 else None
    colours = channels if alpha is None else channels[..., :-1]
    # Nav2 averages opacity with the colours in trinary mode, so that old transparent maps read as they always did.
    shade = (channels if mode == "trinary" else colours).mean(axis=-1)
    if mode == "raw":
        values = np.rint(shade * 255)
        return np.where(values <= 100, values, -1).astype(np.int8)
    occupied_from, free_to = meta.number("occupied_thresh"), meta.number("free_thresh")
    if not 0 <= free_to < occupied_from <= 1:
        raise BadFile(f"{meta.path}: free_thresh {free_to} must be below occupied_thresh {occupied_from}, both in 0..1")
    share = shade if meta.negate() else 1 - shade
    between = np.rint(100 * (share - free_to) / (occupied_from - free_to)) if mode == "scale" else -1
    cells = np.where(share >= occupied_from, 100, np.where(share <= free_to, 0, between))
    if mode == "scale" and alpha is not None:
        cells = np.where(alpha < 1, -1, cells)
    return cells.astype(np.int8)
