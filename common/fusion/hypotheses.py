"""Hypotheses about where one map lies in another: proposed, refined, weighed, the distinct best first."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.fusion.correlate import propose_by_correlation
from common.fusion.evidence import AGREES, CONTRADICTS, Evidence, classify, weigh
from common.fusion.features import propose_by_features
from common.fusion.matchmap import MatchMap
from common.fusion.refine import FINAL_REACH_M, SIGMA_M, SPACING_M, refine
from common.fusion.settings import FusionSettings
from common.fusion.walls import Walls
from common.geometry.se2 import wrap

QUICK_SAMPLES = 300
QUICK_STEPS = 7
APART_M, APART_RAD = 0.5, math.radians(5)
"""hypotheses nearer than both of these are one"""
NUDGES_M = (-0.6, -0.3, 0.3, 0.6)
"""from where refinement is tried again: it may have stopped short along a corridor"""
SLIDES_M = (-3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0)
CONFLICT_PRICE = 6.0
"""metres of agreeing wall that a metre of contradiction outweighs"""


class Hypothesis(NamedTuple):
    pose: NDArray[np.float64]
    """(3,) pose of b's frame in a's"""
    information: NDArray[np.float64]
    """(3, 3) inverse covariance of x, y, theta"""
    evidence: Evidence

    @property
    def score(self) -> float:
        """Metres of agreeing wall less what contradictions cost."""
        return self.evidence.agreeing_m - CONFLICT_PRICE * self.evidence.conflicting_m

    @property
    def grip_m(self) -> float:
        """Metres of wall that stand across the direction in which the placement is held least."""
        return float(np.linalg.eigvalsh(self.information[:2, :2])[0]) * SIGMA_M**2 * SPACING_M

    def slid(self, distance_m: float) -> NDArray[np.float64]:
        """The pose moved by so much in the direction in which it is held least."""
        _, directions = np.linalg.eigh(self.information[:2, :2])
        return self.pose + distance_m * np.array([*directions[:, 0], 0.0])


def search(
    a: MatchMap, b: MatchMap, settings: FusionSettings, seed: int, priors: Iterable[NDArray[np.float64]] = ()
) -> list[Hypothesis]:
    """Distinct hypotheses of the pose of b's frame in a's, best score first."""
    proposals = [np.asarray(list(priors), np.float64).reshape(-1, 3), propose_by_correlation(a, b, settings)]
    if settings.features:
        found = a.features(settings.features), b.features(settings.features)
        proposals.append(propose_by_features(*found, settings.feature_hypotheses, seed))
    quick = b.sample.at(np.arange(len(b.sample.points))[:QUICK_SAMPLES])
    rough = [refine(a, quick, pose, settings.reach_m, QUICK_STEPS) for pose in np.concatenate(proposals)]
    rough.sort(key=lambda result: -_promise(a, quick, result.pose, settings))
    middle = b.walls.points.mean(axis=0)
    first = distinct(np.array([result.pose for result in rough]).reshape(-1, 3), middle)[: settings.refined]
    hypotheses = [judge(a, b, rough[k].pose, settings) for k in first]
    if hypotheses:
        best = max(hypotheses, key=lambda one: one.score)
        hypotheses += [judge(a, b, best.slid(distance), settings) for distance in NUDGES_M]
        hypotheses.sort(key=lambda one: -one.score)
        hypotheses[0] = judge(a, b, hypotheses[0].pose, settings, FINAL_REACH_M)
    return [hypotheses[k] for k in distinct(np.array([one.pose for one in hypotheses]).reshape(-1, 3), middle)]


def slides(a: MatchMap, b: MatchMap, best: Hypothesis, settings: FusionSettings) -> list[Hypothesis]:
    """Rivals of a placement that refinement would pull back to it: itself, moved along its weakest direction.

    In a bare corridor they are nearly as good as it, although no other peak of the search says so.
    """
    poses = (best.slid(distance) for distance in SLIDES_M)
    return [Hypothesis(pose, best.information, weigh(a, b, pose, settings)) for pose in poses]


def judge(
    a: MatchMap, b: MatchMap, pose: NDArray[np.float64], settings: FusionSettings, reach_m: float = 0.25
) -> Hypothesis:
    """The hypothesis near `pose`, refined to the end and weighed."""
    result = refine(a, b.sample, pose, reach_m, wall_m=b.wall_m)
    return Hypothesis(result.pose, result.information, weigh(a, b, result.pose, settings))


def _promise(a: MatchMap, quick: Walls, pose: NDArray[np.float64], settings: FusionSettings) -> float:
    """The score of a rough hypothesis by a few of b's walls, in walls."""
    counts = np.bincount(classify(a, quick, pose, settings), minlength=4)
    return float(counts[AGREES] - CONFLICT_PRICE * counts[CONTRADICTS])


def distinct(poses: NDArray[np.float64], middle: NDArray[np.float64]) -> list[int]:
    """Indices of the poses (n, 3), in their order, without those near an earlier one, seen at b's `middle` (2,)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * middle[0] - s * middle[1]
    y = poses[:, 1] + s * middle[0] + c * middle[1]
    free = np.ones(len(poses), np.bool_)
    kept = []
    for k in range(len(poses)):
        if free[k]:
            kept.append(k)
            near = np.hypot(x - x[k], y - y[k]) <= APART_M
            free &= ~(near & (np.abs(wrap(poses[:, 2] - poses[k, 2])) <= APART_RAD))
    return kept
