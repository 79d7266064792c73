"""What happens on the bus besides messages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Alive:
    """A liveliness token came or went. A lost router takes all tokens away at once: see `Link`."""

    key: str
    alive: bool


@dataclass(frozen=True)
class Link:
    """The router came or went."""

    up: bool
