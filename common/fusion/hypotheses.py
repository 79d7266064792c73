"""Hypotheses about where one map lies in another: proposed, refined, weighed, the distinct best first."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from common.fusion.bend import Bend, bend, weigh_bent
from common.fusion.correlate import propose_by_correlation
from common.fusion.evidence import AGREES, CONTRADICTS, Evidence, classify, weigh
from common.fusion.features import propose_by_features
from common.fusion.matchmap import FIRST_SAMPLES, MatchMap
from common.fusion.refine import FINAL_REACH_M, SIGMA_M, SPACING_M, refine, refine_all
from common.fusion.settings import FusionSettings
from common.fusion.walls import Walls

QUICK_STEPS = 7
APART_M, APART_RAD = 0.5, math.radians(5)
"""hypotheses nearer than both of these are one"""
NUDGES_M = (-0.6, -0.3, 0.3, 0.6)
"""from where refinement is tried again: it may have stopped short along a corridor"""
SLIDES_M = (-3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0)
CONFLICT_PRICE = 6.0
"""metres of agreeing wall that a metre of contradiction outweighs"""
ROUGH_AGREEING_M = 4.0
"""metres of agreeing wall from which on a proposal is worth refining to the end"""
BENT_TRIALS = 3
"""hypotheses that are weighed as bent when no rigid one convinces"""
BENT_PROMISE_M, BENT_PRICE = 15.0, 2.0
"""and what they must score at this price of contradictions"""
SAME_SCORE_M = 1.0
"""scores nearer than this say the same"""
ROUGH_PRICE = 1.0
"""the same while proposals are sifted: a bent map contradicts itself at any rigid placement"""


class Hypothesis(NamedTuple):
    pose: NDArray[np.float64]
    """(3,) pose of b's frame in a's"""
    information: NDArray[np.float64]
    """(3, 3) inverse covariance of x, y, theta"""
    evidence: Evidence
    bent: Bend | None = None
    """how b is bent in a, when the evidence is about that and not about the rigid pose"""

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
    return settle(a, b, np.concatenate(proposals), settings)


def settle(a: MatchMap, b: MatchMap, proposals: NDArray[np.float64], settings: FusionSettings) -> list[Hypothesis]:
    """Distinct hypotheses that refinement makes of proposed poses (n, 3) of b's frame in a's, best score first."""
    quick = b.sample.at(np.arange(len(b.sample.points))[:FIRST_SAMPLES])
    rough = refine_all(a, quick, proposals, settings.reach_m, QUICK_STEPS)
    middle = b.walls.points.mean(axis=0)
    sifted = rough[_sifted(a, b, quick, rough, settings)]
    first = sifted[distinct(sifted, middle)[: settings.refined]]
    hypotheses = [judge(a, b, pose, settings) for pose in first]
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


def straighten(a: MatchMap, b: MatchMap, hypothesis: Hypothesis, settings: FusionSettings) -> Hypothesis:
    """The hypothesis weighed again with b bent to fit, unless that says less for it."""
    bent = bend(a, b, hypothesis.pose, settings)
    found = hypothesis._replace(evidence=weigh_bent(a, b, bent, settings), bent=bent)
    return found if found.score > hypothesis.score - SAME_SCORE_M else hypothesis


def straighten_best(
    a: MatchMap, b: MatchMap, hypotheses: list[Hypothesis], settings: FusionSettings
) -> list[Hypothesis]:
    """The hypotheses, best first, after the most promising have been weighed as bent."""

    def promise(k: int) -> float:
        evidence = hypotheses[k].evidence
        return evidence.agreeing_m - BENT_PRICE * evidence.conflicting_m

    chosen = [k for k in range(len(hypotheses)) if promise(k) >= BENT_PROMISE_M]
    chosen = sorted(chosen, key=lambda k: -promise(k))[:BENT_TRIALS]
    weighed = [straighten(a, b, one, settings) if k in chosen else one for k, one in enumerate(hypotheses)]
    return sorted(weighed, key=lambda one: -one.score)


def _sifted(
    a: MatchMap, b: MatchMap, quick: Walls, poses: NDArray[np.float64], settings: FusionSettings
) -> NDArray[np.int64]:
    """Indices of rough hypotheses that agree at all, in turn by two scores of a few of b's walls.

    The full price finds a small overlap among much that agrees by chance, the low one a large overlap of bent maps.
    """
    counts = np.array([np.bincount(classify(a, quick, pose, settings), minlength=4) for pose in poses]).reshape(-1, 4)
    ranks = []
    for price in (CONFLICT_PRICE, ROUGH_PRICE):
        order = np.argsort(price * counts[:, CONTRADICTS] - counts[:, AGREES], kind="stable")
        ranks.append(np.argsort(order, kind="stable"))
    order = np.argsort(np.minimum(*ranks), kind="stable")
    agreeing_m = counts[:, AGREES] * (b.wall_m / len(quick.points))
    return np.asarray(order[agreeing_m[order] >= ROUGH_AGREEING_M])


def distinct(poses: NDArray[np.float64], middle: NDArray[np.float64]) -> list[int]:
    """Indices of the poses (n, 3), in their order, without those near an earlier one, seen at b's `middle` (2,)."""
    return [int(k) for k in np.flatnonzero(_distinct(poses, middle))]


@njit(cache=True)
def _distinct(poses: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.bool_]:
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * middle[0] - s * middle[1]
    y = poses[:, 1] + s * middle[0] + c * middle[1]
    kept = np.zeros(len(poses), np.bool_)
    for k in range(len(poses)):
        kept[k] = True
        for i in range(k):
            turn = abs((poses[k, 2] - poses[i, 2] + math.pi) % (2 * math.pi) - math.pi)
            if kept[i] and math.hypot(x[k] - x[i], y[k] - y[i]) <= APART_M and turn <= APART_RAD:
                kept[k] = False
                break
    return kept
