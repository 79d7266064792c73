"""How much measurements of one thing differ from one report to the next, as a share of it."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable
from statistics import median

RECENT = 200
FEW = 5
SIGMA = 1.4826 / 2**0.5
"""sigma of one value, over the median of the absolute differences between successive ones"""


class Noise:
    """Pooled over all things; a thing that has changed for good counts once, not as noise."""

    def __init__(self) -> None:
        self._last: dict[Hashable, float] = {}
        self._off: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))

    def took(self, stage: str, thing: Hashable, value: float) -> None:
        """A new value of this thing; one that is exactly the last is the same report again."""
        last = self._last.get((stage, thing))
        if value > 0 and last is not None and value != last:
            self._off[stage].append(2 * abs(value - last) / (value + last))
        if value > 0:
            self._last[stage, thing] = value

    def shares(self) -> dict[str, float]:
        """Stage → standard deviation of one value as a share of it, 0 as long as too little has been seen."""
        return {stage: SIGMA * median(off) for stage, off in self._off.items() if len(off) >= FEW}
