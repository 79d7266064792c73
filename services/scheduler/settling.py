"""Whether a plan is worth what it changes.

Every predicted time rests on measurements, and what they differ by from report to report says by how much it may be
off. Times that differ by less are taken to be equal; then robots' SLAM stays where it is, and of the groupings the one
with the least cut (Eq. 5) is the best, as an edge can only match what overlaps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from services.scheduler.costs import Ints, Prediction, Problem, predict
from services.scheduler.graph import Groups, Weights, cut
from services.scheduler.regrouping import closest

SURE = 2.0
"""standard deviations below which a difference is noise"""
STAGES = {
    "transfer": "transfer",
    "slam": "slam",
    "carry": "transfer",
    "fuse": "fuse",
    "upload": "transfer",
    "merge": "fuse",
}
"""stage of a prediction → what its noise is measured on"""


class Settled(NamedTuple):
    slam: Ints
    fuse: Ints
    why: str
    """empty: the plan as it was made"""


def blur(prediction: Prediction, noise: Mapping[str, float]) -> float:
    """Seconds by which the predicted time may be off, by the noise of each stage on the critical path."""
    off = (noise.get(STAGES.get(stage.what, ""), 0.0) * stage.seconds for stage in prediction.critical)
    return SURE * math.sqrt(sum(each**2 for each in off))


def settle(
    problem: Problem,
    weights: Weights,
    slam: Ints,
    fuse: Ints,
    groups: Callable[[], Groups],
    noise: Mapping[str, float],
    hysteresis: float,
    spent: Callable[[], float],
) -> Settled:
    """The plan (slam, fuse), both (V,), if it is better than the present one by more than noise and by `hysteresis`.

    Otherwise SLAM stays, and fusing edges too, unless within the noise there is a grouping, no less even than the
    present one or `groups`, of a cut smaller by the share `hysteresis` of all overlap.
    """
    present = problem.current_fuse
    if (present < 0).any() or (problem.current_slam < 0).any():
        return Settled(slam, fuse, "")
    best = predict(problem, slam, fuse)
    now = predict(problem, problem.current_slam, present).total
    tie = max(hysteresis * now, blur(best, noise))
    if now - best.total > tie:
        return Settled(slam, fuse, "")
    count = len(problem.edges)
    most = np.maximum(np.bincount(present, minlength=count), math.ceil(len(present) / count))
    bound = max(now, best.total + tie)
    near = closest(problem, weights, problem.current_slam, present, groups(), bound, spent, most)
    if float(cut(weights, present) - cut(weights, near)) > hysteresis * float(weights.sum()) / 2:
        return Settled(problem.current_slam, near, f"regrouped by overlap alone: times differ by less than {tie:.3f} s")
    return Settled(problem.current_slam, present, f"kept: nothing better by more than {tie:.3f} s")
