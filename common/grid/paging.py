"""Changed tiles in pages, oldest change first: a tile that changes between two pages comes again at the end, so that
whoever has taken all pages has the whole of the last page's version."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from common.errors import UsageError
from common.grid.grid import Grid, TileKey
from common.grid.tiles import encode_counts
from common.grid.versions import life_of

TILE_HEAD = 40
"""bytes that a tile takes in a message at most beside its cells: empty ones are not free"""
TileData = tuple[int, int, int, bytes]
"""x, y, version, encoded cells"""


class Tiled(Protocol):
    resolution: float
    tiles: dict[TileKey, Any]
    version: int
    changed: dict[TileKey, int]


@dataclass(frozen=True)
class Page:
    tiles: list[TileData]
    next: str | None
    """cursor of the page after this one"""


def page(tiled: Tiled, since: int, cursor: str, limit_bytes: int, encode: Callable[[Any], bytes]) -> Page:
    """Tiles changed after version `since`, after `cursor` ("" for the first page), up to about `limit_bytes`.

    A `since` of another life of the map (see versions.py) has the whole map sent. Raises UsageError for a cursor that
    is none, or that is of another life: pages of two maps must not be put together.
    """
    if cursor:
        start = parse_cursor(cursor)
        if life_of(start[0]) != life_of(tiled.version):
            raise UsageError("the map has been begun anew since the page before: fetch it again from the first page")
    else:
        start = (since if life_of(since) == life_of(tiled.version) else 0, (1 << 62, 0))
    order = sorted((version, key) for key, version in tiled.changed.items() if (version, key) > start)
    tiles: list[TileData] = []
    size = 0
    for version, key in order:
        data = encode(tiled.tiles[key])
        if tiles and size + len(data) + TILE_HEAD > limit_bytes:
            last = tiles[-1]
            return Page(tiles, f"{last[2]}.{last[0]}.{last[1]}")
        tiles.append((key[0], key[1], version, data))
        size += len(data) + TILE_HEAD
    return Page(tiles, None)


def counts_page(grid: Grid, since: int, cursor: str, limit_bytes: int) -> dict[str, Any]:
    """A page of counts as plain values, with what it is a page of: what a worker process answers."""
    found = page(grid, since, cursor, limit_bytes, encode_counts)
    return {"tiles": found.tiles, "next": found.next, "version": grid.version, "resolution": grid.resolution}


def parse_cursor(cursor: str) -> tuple[int, TileKey]:
    """(version, tile key) out of "version.x.y"."""
    try:
        version, x, y = (int(part) for part in cursor.split("."))
    except ValueError:
        raise UsageError(f"cursor {cursor!r} is none of ours: pass the `next` of the page before") from None
    return version, (x, y)
