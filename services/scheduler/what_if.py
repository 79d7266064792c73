"""A supposed cluster: edges that are down, or slower or faster than measured."""

from __future__ import annotations

from dataclasses import dataclass, field

from common.errors import UsageError

DOWN = "down"
FACTORS = 1e-3, 1e3
"""least and greatest change of speed that is asked for in earnest"""


@dataclass(frozen=True)
class WhatIf:
    down: frozenset[str] = frozenset()
    speed: dict[str, float] = field(default_factory=dict)
    """edge → factor on its measured speed"""

    @classmethod
    def parse(cls, text: str) -> WhatIf:
        """Out of `edge-2=down,edge-1=0.5`. Raises UsageError saying what is meant."""
        down, speed = set(), {}
        for part in filter(None, text.split(",")):
            edge, _, word = part.partition("=")
            try:
                if word == DOWN:
                    down.add(edge)
                elif FACTORS[0] <= (factor := float(word)) <= FACTORS[1]:
                    speed[edge] = factor
                else:
                    raise ValueError
            except ValueError:
                raise UsageError(
                    f"what if {part!r}: say EDGE=down, or EDGE=FACTOR, 0.001 to 1000, on its speed, as edge-1=0.5"
                ) from None
        return cls(frozenset(down), speed)

    def check(self, edges: list[str]) -> None:
        """Raises UsageError for an edge that is not there, or when none is left."""
        strange = sorted((self.down | set(self.speed)) - set(edges))
        if strange:
            raise UsageError(
                f"what if {', '.join(strange)}: no such edge is up; there are {', '.join(edges) or 'none'}"
            )
        if not set(edges) - self.down:
            raise UsageError("what if all edges were down: nothing would run; leave one up")
