"""How fast bytes come from each peer, out of the pages that had to be fetched anyway."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict, deque
from statistics import median

from common.wire import LinkStatus

RECENT = 32
SPREAD_BYTES = 32_768
"""pages that differ by less say nothing about speed when compared: what they waited for says more"""
ENOUGH_PAIRS = 8


class LinkMeter:
    """Robust against the odd page that waited for something else: medians throughout (Theil-Sen line)."""

    def __init__(self) -> None:
        self._pages: dict[str, deque[tuple[int, float]]] = defaultdict(lambda: deque(maxlen=RECENT))
        self._taken: Counter[str] = Counter()

    def took(self, peer: str, size: int, seconds: float) -> None:
        """A page of `size` bytes from `peer` came `seconds` after it had been asked for."""
        if size > 0 and seconds > 0:
            self._pages[peer].append((size, seconds))
            self._taken[peer] += 1

    def taken(self, tier: str) -> dict[str, int]:
        """Pages that have come so far from each peer of a tier (as `robot/`), by name."""
        return {peer.removeprefix(tier): count for peer, count in self._taken.items() if peer.startswith(tier)}

    def statuses(self) -> tuple[LinkStatus, ...]:
        return tuple(
            LinkStatus(peer=peer, bytes_per_s=speed, delay_s=delay, pages=len(pages))
            for peer, pages in sorted(self._pages.items())
            for speed, delay in [line(list(pages))]
        )


def line(pages: list[tuple[int, float]]) -> tuple[float, float]:
    """(bytes/s, delay s) through (bytes, s) pages; speed 0: not to be told, as sizes are too much alike."""
    slopes = [
        (late - soon) / (large - small)
        for (small, soon), (large, late) in itertools.combinations(sorted(pages), 2)
        if large - small >= SPREAD_BYTES
    ]
    slope = median(slopes) if len(slopes) >= ENOUGH_PAIRS else 0.0
    if slope <= 0:
        return 0.0, median(seconds for _, seconds in pages)
    return 1 / slope, max(0.0, median(seconds - size * slope for size, seconds in pages))
