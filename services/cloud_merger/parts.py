"""Edge maps as they lie in the merging process, and what they contain together."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from common.wire import Covers, EdgeMapNotice


@dataclass(frozen=True)
class Part:
    """The map of one edge."""

    notice: EdgeMapNotice
    """what it was fetched after; what came may be newer"""
    version: int
    world_epoch: int
    covers: Covers
    final: bool


def together(parts: Mapping[str, Part], fused_at: Callable[[str], Collection[str]]) -> Covers | None:
    """What the edges' maps contain; None while a robot moves between two: their next versions say where it is."""
    covers: Covers = {}
    for edge, part in parts.items():
        if set(part.covers) & set(covers) or not set(part.covers) <= set(fused_at(edge)):
            return None
        covers |= part.covers
    return covers
