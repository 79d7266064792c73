"""Tiled maps over the bus: pages of what has changed, on the owner's and on the asker's side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from common.bus.bus import Bus
from common.errors import QueryFailed
from common.grid.versions import life_of
from common.wire import Cover, Covers, Tile, TilePage
from common.wire.limits import MAX_PAGE_BYTES

TILE_BYTES = MAX_PAGE_BYTES - 16_384
"""tile data in one page, so that the page with its other fields stays below the limit"""


@dataclass(frozen=True)
class Delta:
    """The tiles of a map that changed since a version, and what the map then contained."""

    resolution: float
    version: int
    tiles: list[Tile]
    whole: bool
    """these are all tiles of the map: what is held of it beside them is out of date"""
    covers: Covers
    final: bool
    world_epoch: int
    size: int
    """bytes of tile data"""


async def fetch_tiles(bus: Bus, key: str, since: int = 0, *, kind: str = "counts", timeout_s: float = 10.0) -> Delta:
    """What changed at `key` after version `since`. Raises QueryFailed when its owner does not give it.

    Raises it also when the map is begun anew or changes its lattice between two pages: the tiles would be of two maps.
    """
    tiles: list[Tile] = []
    last: TilePage | None = None
    async for page in bus.pages(key, {"since": since, "kind": kind}, timeout_s=timeout_s):
        if not isinstance(page, TilePage):
            raise QueryFailed(f"answered {type(page).__name__}, not TilePage", key)
        if last is not None and _identity(page) != _identity(last):
            raise QueryFailed("the map was begun anew while fetching; fetch again", key)
        tiles += page.tiles
        last = page
    if last is None:
        raise QueryFailed("no page came", key)
    size = sum(len(tile.data) for tile in tiles)
    whole = since == 0 or life_of(since) != life_of(last.version)
    return Delta(last.resolution, last.version, tiles, whole, last.covers, last.final, last.world_epoch, size)


def _identity(page: TilePage) -> tuple[int, float, int]:
    return life_of(page.version), page.resolution, page.world_epoch


def tile_page(
    source: str, kind: Any, page: Mapping[str, Any], covers: Mapping[str, Cover], final: bool, world_epoch: int
) -> TilePage:
    """A worker's page of tiles (see common.grid.paging) as the message."""
    return TilePage(
        source=source,
        kind=kind,
        resolution=page["resolution"],
        version=page["version"],
        tiles=tuple(Tile(x=x, y=y, version=version, data=data) for x, y, version, data in page["tiles"]),
        covers=dict(covers),
        final=final,
        world_epoch=world_epoch,
        next=page["next"],
    )
