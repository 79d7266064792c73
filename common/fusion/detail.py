"""What sets one place apart from others of its shape, in metres of wall.

Two walls and two cross walls coincide wherever rooms are alike, with hardly a contradiction and without a rival in
these two maps. So a small overlap must agree in more than that: in detail beyond a few straight lines, or in so much
wall that no other placement comes near, and without a contradiction in one piece, which a door in another place is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.fusion.evidence import AGREES, classify
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
BLOB_PRICE = 7.0
"""metres of detail that a metre of coherent contradiction outweighs"""


def distinction_m(detail_m: float, lead_m: float, blob_m: float) -> float:
    """How far a placement is set apart: its detail, its lead over the best other one, its largest contradiction, all m.

    The weights part right placements of real maps with little detail from wrong ones of drawn buildings full of rooms
    alike (a logistic regression, rounded).
    """
    return detail_m + LEAD_WORTH * lead_m - BLOB_PRICE * blob_m


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
