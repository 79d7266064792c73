"""Start poses tell which of several placements that look alike is meant.

A start pose is off by some decimetres and degrees, and a degree is a wall's width ten metres away: so a placement is
looked for wherever the two start poses may put the pair, as far as their errors and the way between them let it lie.
One that fits is taken when no other fits there about as well, or lies clearly nearer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.fusion.cycles import Measurement, Pair
from common.fusion.decide import judge_alone
from common.fusion.hypotheses import Hypothesis, settle
from common.fusion.match import track
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.fusion.solve import START_INFORMATION, difference_by
from common.geometry.se2 import Pose, between, compose, wrap
from common.wire.edge import PairVerdict

SIGMAS = 3.5
"""how many standard deviations start poses are believed to be off at most"""
STEP_M = 0.6
"""how far apart the places are from which walls are brought to walls; refinement finds its way from half of it"""
CLEARLY = 9.0
"""squared standard deviations by which one placement must lie nearer than another that fits as well"""


def told_by_starts(
    verdicts: Iterable[PairVerdict],
    maps: Mapping[str, MatchMap],
    starts: Mapping[str, ArrayLike],
    settings: FusionSettings,
) -> dict[Pair, Measurement]:
    """Transforms of pairs that look alike in several ways, conflict, or were not searched, where start poses tell which
    way is meant.

    What conflicts may be another room that looks alike; where start poses say, its walls must then agree.
    """
    out: dict[Pair, Measurement] = {}
    for each in verdicts:
        open_ = each.kind in ("ambiguous", "conflict") or (each.kind != "merged" and not each.searched)
        if open_ and {each.a, each.b} <= starts.keys() & maps.keys():
            strict = each.kind == "conflict"
            found = meant(maps[each.a], maps[each.b], starts[each.a], starts[each.b], settings, strict)
            if found is not None:
                out[each.a, each.b] = found
    return out


def meant(
    a: MatchMap, b: MatchMap, start_a: ArrayLike, start_b: ArrayLike, settings: FusionSettings, strict: bool = False
) -> Measurement | None:
    """Where b lies in a by walls and by start poses both, None when these do not tell.

    `strict`: only where the walls would be merged if nothing else were alike.
    """
    told = between(start_a, start_b)
    spread = _spread(np.asarray(start_a, np.float64), np.asarray(start_b, np.float64))
    if min(a.wall_m, b.wall_m) < settings.min_walls_m or a.resolution != b.resolution:
        return None
    found = settle(a, b, _places(told, spread, b), settings)
    found = [one for one in found if _squared(one.pose, told, spread) <= SIGMAS**2]
    fitting = [one for one in found if judge_alone(one, settings)[0] == "merged"]
    if not fitting and not strict:
        fitting = found[:1]
    chosen = _chosen(fitting, told, spread, settings)
    if chosen is None:
        return None
    proof = track(a, b, chosen.pose, settings=settings)
    if proof.transform is None or proof.information is None or _squared(proof.transform, told, spread) > SIGMAS**2:
        return None
    return Measurement(proof.transform, proof.information)


def _chosen(
    fitting: list[Hypothesis], told: Pose, spread: NDArray[np.float64], settings: FusionSettings
) -> Hypothesis | None:
    """The best of the hypotheses (best first), or of several about as good the one that lies clearly nearest."""
    rivals = [one for one in fitting if one.score >= settings.max_runner_up * fitting[0].score]
    rivals.sort(key=lambda one: _squared(one.pose, told, spread))
    distances = [_squared(one.pose, told, spread) for one in rivals[:2]]
    return rivals[0] if len(rivals) == 1 or (rivals and distances[1] - distances[0] >= CLEARLY) else None


def _spread(start_a: Pose, start_b: Pose) -> NDArray[np.float64]:
    """(3, 3) covariance of `between(start_a, start_b)`."""
    by_a, by_b = difference_by(start_a, start_b)
    each = np.linalg.inv(START_INFORMATION)
    return np.asarray(by_a @ each @ by_a.T + by_b @ each @ by_b.T)


def _squared(pose: Pose, told: Pose, spread: NDArray[np.float64]) -> float:
    """Squared distance of a pose from the one that is told, in standard deviations."""
    gap = pose - told
    gap[2] = wrap(gap[2])
    return float(gap @ np.linalg.solve(spread, gap))


def _places(told: Pose, spread: NDArray[np.float64], b: MatchMap) -> NDArray[np.float64]:
    """(n, 3) poses all over where b's frame may be in a's, at most STEP_M apart for b's walls."""
    points = b.walls.points
    middle = np.array([*points.mean(axis=0), 0.0])
    radius = float(np.sqrt(((points - middle[:2]) ** 2).sum(axis=1).mean()))
    x, y, _ = compose(told, middle) - told
    to_metres = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, radius]])
    squares, axes = np.linalg.eigh(to_metres @ spread @ to_metres.T)
    sigmas = np.sqrt(squares)
    ticks = [np.linspace(-SIGMAS, SIGMAS, 1 + 2 * int(np.ceil(SIGMAS * sigma / STEP_M))) for sigma in sigmas]
    lattice = np.array(list(product(*ticks)))
    lattice = lattice[np.linalg.norm(lattice, axis=1) <= SIGMAS]
    return np.asarray(told + lattice * sigmas @ axes.T @ np.linalg.inv(to_metres).T)
