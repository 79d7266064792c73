"""What a robot collects its sweeps from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from common.sweep import Sweep


@dataclass(frozen=True)
class SourceProfile:
    """What is known of a source before its first sweep."""

    name: str
    """for the operator, e.g. `carmen intel.log.gz, part 1 of 3`"""
    sensor: str
    """name of the laser"""
    range_max: float
    """m, 0 when unknown"""
    can_wait: bool
    """It holds all its sweeps (a log, a simulation): it may be asked late without losing any, and gives the same ones
    again after a restart. A live source loses what is not taken in time."""


class Source(Protocol):
    """Yields sweeps; errors that it raises end the robot, bad sweeps that it yields do not."""

    @property
    def profile(self) -> SourceProfile: ...

    def sweeps(self) -> Iterator[Sweep]:
        """All sweeps from the first, stamps rising. Called once."""
        ...
