"""What sets one place apart from others of its shape, in metres of wall.

Two walls and two cross walls coincide wherever rooms are alike, with hardly a contradiction and without a rival in
these two maps. So a small overlap must agree in more than that: in detail beyond a few straight lines, or in so much
wall that no other placement comes near. And every door in another place counts against it, in full, but not what is
explained by drift between the maps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.fusion.bend import Bend, weigh_bent
from common.fusion.decide import NOISE_M
from common.fusion.evidence import AGREES, classify, pieces_m, weigh
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.fusion.walls import STRAIGHT

PLAIN_LINES = 4
LINE_M = 0.2
"""walls nearer to a line than this belong to it"""
TRIED = 120
"""walls whose lines are tried at most, each time, spread over the map"""


LEAD_WORTH = 0.4
"""metres of detail that a metre's lead over the best other placement is worth"""
PIECE_PRICE = 5.0
"""metres of detail that a metre of contradicting wall outweighs: a door, of which some 0.7 m are seen, outweighs what a
merge must be set apart by at least"""


def distinction_m(detail_m: float, lead_m: float, against_m: float) -> float:
    """How far a placement is set apart: its detail, its lead over the best other one, what contradicts it, all m.

    The weights part right placements of real maps with little detail from wrong ones of drawn buildings full of rooms
    alike (a logistic regression, rounded).
    """
    return detail_m + LEAD_WORTH * lead_m - PIECE_PRICE * against_m


def against_m(
    a: MatchMap, b: MatchMap, pose: NDArray[np.float64], bent: Bend | None, settings: FusionSettings
) -> float:
    """Metres of wall of both maps that contradict in pieces as large as a thing, b's frame being at `pose` in a's, or
    where `bent` says.

    A wall in the other's free space contradicts from where it no longer agrees, without the room that drift needs.
    """
    strict = settings.model_copy(update={"contradiction_m": settings.tolerance_m})
    told = weigh(a, b, pose, strict) if bent is None else weigh_bent(a, b, bent, strict)
    pieces = pieces_m(told.clashing)
    return float(pieces[pieces > NOISE_M].sum())


def detail_m(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> float:
    """Metres of b's agreeing wall that lie on none of the PLAIN_LINES longest lines, b's frame being at `pose` in a's.

    Lines are taken greedily: each time the one through an agreeing wall, along it, that most of the rest lie on.
    """
    walls = b.sample.at(np.flatnonzero(classify(a, b.sample, pose, settings) == AGREES))
    left = np.ones(len(walls.points), np.bool_)
    for _ in range(PLAIN_LINES):
        tried = np.flatnonzero(left & (walls.straightness > STRAIGHT))
        tried = tried[:: -(-len(tried) // TRIED) or 1]
        if not len(tried):
            break
        offsets = (walls.normals[tried] * walls.points[tried]).sum(axis=1)
        on = (np.abs(walls.normals[tried] @ walls.points.T - offsets[:, None]) < LINE_M) & left
        left &= ~on[int(on.sum(axis=1).argmax())]
    return float(left.sum()) * b.wall_m / max(len(b.sample.points), 1)
