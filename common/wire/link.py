"""What a receiver has measured of the way from one sender."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from common.wire.base import Part


class LinkStatus(Part):
    """Measured on what had to be carried anyway: pages of a backfill, pages of tiles."""

    peer: Annotated[str, Field(max_length=128)]
    """sender, as `robot/r1` or `edge/e1`"""
    bytes_per_s: float
    """0: not to be told yet, as the pages were too much alike"""
    delay_s: float
    """what an empty page would take"""
    pages: int
    """recent pages that this rests on"""
