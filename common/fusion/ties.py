"""Ties between two robots: how one map lies in the other, place by place, from where a rigid placement puts it.

Nothing is searched for: each patch is refined from its neighbour's placement (common.fusion.bend) and must convince by
its walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.fusion.bend import AROUND_M, MIN_WALLS, bend
from common.fusion.evidence import AGREES, OUTSIDE, classify
from common.fusion.matchmap import MatchMap
from common.fusion.refine import FINAL_REACH_M, refine
from common.fusion.settings import FusionSettings

STEPS = 4
FITS = 0.7
"""share of the walls around a place that must agree there"""
FLOOR = np.diag([0.02**2, 0.02**2, 0.004**2])
"""covariance that every tie has at least: walls of grids are known to half a cell, and neighbours share theirs"""
FREE = np.eye(3)
"""information, 1/m^2 and 1/rad^2, of directions in which the walls of a place say nothing"""


class Tie(NamedTuple):
    """How b lies in a around one place."""

    middle: NDArray[np.float64]
    """(2,) m, the place in b's frame"""
    pose: NDArray[np.float64]
    """(3,) pose of b's frame in a's that holds there"""
    covariance: NDArray[np.float64]
    """(3, 3) of that pose, without FLOOR"""


def ties(a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings) -> list[Tie]:
    """Ties between maps placed by `pose`, the pose of b's frame in a's; none where their walls do not tell."""
    if not len(a.sample.points) or not len(b.sample.points):
        return []
    found = []
    bent = bend(a, b, pose, settings)
    for middle, placed in zip(bent.middles, bent.poses, strict=True):
        around = b.sample.at(np.flatnonzero(np.square(b.sample.points - middle).sum(axis=1) < AROUND_M**2))
        labels = classify(a, around, placed, settings)
        known = int((labels != OUTSIDE).sum())
        if known < 2 * MIN_WALLS or (labels == AGREES).sum() < FITS * known:
            continue
        metres = b.wall_m * len(around.points) / len(b.sample.points)
        here = refine(a, around, placed, FINAL_REACH_M, STEPS, metres)
        found.append(Tie(middle, here.pose, np.asarray(np.linalg.inv(here.information + FREE), np.float64)))
    return found
