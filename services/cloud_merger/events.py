"""What reaches the cloud's state machine, and what it asks its shell to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from common.fusion.cycles import Pair
from common.wire import Covers, EdgeMapNotice, MapNotice, PairVerdict, Routes, Transforms, Verdicts


@dataclass(frozen=True)
class Routed:
    routes: Routes


@dataclass(frozen=True)
class MapNoticed:
    notice: MapNotice


@dataclass(frozen=True)
class EdgeMapNoticed:
    notice: EdgeMapNotice


@dataclass(frozen=True)
class VerdictsCame:
    edge: str
    verdicts: Verdicts


@dataclass(frozen=True)
class SketchFetched:
    """The robot's sketch is held at least at the version of the notice."""

    fetch: FetchSketch


@dataclass(frozen=True)
class PartFetched:
    """An edge map is held, as its edge showed it when it was asked."""

    fetch: FetchPart
    version: int
    world_epoch: int
    covers: Covers
    final: bool


@dataclass(frozen=True)
class FetchFailed:
    fetch: FetchSketch | FetchPart


@dataclass(frozen=True)
class Solved:
    """A solve has ended; None when it failed."""

    transforms: Transforms | None


@dataclass(frozen=True)
class Composed:
    """A composition has ended; one that failed is tried again at the next tick."""

    well: bool


@dataclass(frozen=True)
class Tick:
    """Every `merge_every_s`."""


Event = (
    Routed
    | MapNoticed
    | EdgeMapNoticed
    | VerdictsCame
    | SketchFetched
    | PartFetched
    | FetchFailed
    | Solved
    | Composed
    | Tick
)


@dataclass(frozen=True)
class FetchSketch:
    """Fetch the whole sketch of the robot map that the notice tells of."""

    notice: MapNotice

    @property
    def name(self) -> str:
        """Of what is fetched."""
        return f"robot/{self.notice.robot}"


@dataclass(frozen=True)
class FetchPart:
    """Fetch the edge map that the notice tells of, and put it on top of what is held since that version."""

    notice: EdgeMapNotice
    since: int

    @property
    def name(self) -> str:
        """Of what is fetched."""
        return f"edge/{self.notice.edge}"


@dataclass(frozen=True)
class Forget:
    robot: str


@dataclass(frozen=True)
class Solve:
    """Decide `pairs` here, with the help of the edges' verdicts, and solve the world.

    Live, these are the pairs across edges; for the final world all, of which edges have searched many."""

    robots: tuple[str, ...]
    pairs: tuple[Pair, ...]
    verdicts: tuple[PairVerdict, ...]
    final: bool
    previous: Transforms | None
    above: int
    """a new world epoch must be higher than this"""


@dataclass(frozen=True)
class Compose:
    """Add the maps of these edges, each of the version given."""

    versions: Mapping[str, int]
    world: Transforms
    covers: Covers
    final: bool
    changes: tuple[str, ...]
    """of robot maps since the last composition"""


Instruction = FetchSketch | FetchPart | Forget | Solve | Compose
