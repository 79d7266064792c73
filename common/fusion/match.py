"""Matching two robot maps: features and correlation propose, geometry decides.

`match` looks everywhere; `track` only confirms and sharpens what has been decided. Both depend on nothing but their
arguments, so a verdict can be made again anywhere, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import Unmergeable
from common.fusion.bend import Bend, bend, loosened
from common.fusion.decide import decide, judge_alone, runner_up
from common.fusion.detail import against_m, detail_m, distinction_m
from common.fusion.hypotheses import Hypothesis, judge, search, slides, straighten, straighten_best
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import overlap
from common.fusion.settings import FusionSettings
from common.geometry.se2 import Pose
from common.wire.edge import PairVerdict, VerdictKind

STRAIGHT_SHARE = 0.9
"""share of agreeing wall from which on maps are taken for straight, when no piece of wall stands beside its own"""


@dataclass(frozen=True)
class Match:
    """What was decided about a pair of maps, with the evidence."""

    kind: VerdictKind
    reason: str
    transform: Pose | None = None
    """(3,) pose of b's frame in a's; given for `merged` only"""
    information: NDArray[np.float64] | None = None
    """(3, 3) inverse covariance of the transform's x, y (m) and theta (rad); given with it"""
    overlap: float = 0.0
    """|A∩B| / (|A|+|B|) over known cells at the best placement, 0 to 0.5"""
    agreement: float = 0.0
    """share of wall in the overlap that finds a wall"""
    conflict: float = 0.0
    """share of wall in the overlap that lies in the other's free space"""
    runner_up: float = 0.0
    """score of the best distinct other hypothesis over that of the best"""
    score: float = 0.0
    """m of agreeing wall less what contradictions cost"""
    hypotheses: tuple[Hypothesis, ...] = ()
    """the distinct best first, for pictures and explanations"""

    def verdict(self, a: str, b: str, versions: tuple[int, int]) -> PairVerdict:
        """The message about robots `a` and `b`, whose maps of these versions were compared."""
        x = self.transform
        return PairVerdict(
            a=a,
            b=b,
            kind=self.kind,
            versions=versions,
            transform=None if x is None else (float(x[0]), float(x[1]), float(x[2])),
            overlap=self.overlap,
            agreement=self.agreement,
            conflict=self.conflict,
            runner_up=self.runner_up,
            reason=self.reason,
        )


def match(
    a: MatchMap, b: MatchMap, *, settings: FusionSettings | None = None, seed: int = 0, prior: ArrayLike | None = None
) -> Match:
    """Where b lies in a, if anywhere. `prior` is a guess at the pose of b's frame in a's, tried with the others.

    Raises Unmergeable when resolutions differ.
    """
    settings = settings or FusionSettings()
    refusal = _refusal(a, b, settings)
    if refusal is not None:
        return refusal
    priors = [] if prior is None else [np.asarray(prior, np.float64)]
    hypotheses = search(a, b, settings, seed, priors)
    if hypotheses and judge_alone(hypotheses[0], settings)[0] != "merged":
        hypotheses = straighten_best(a, b, hypotheses, settings)
    if hypotheses and judge_alone(hypotheses[0], settings)[0] == "merged":
        hypotheses += slides(a, b, hypotheses[0], settings)
    kind, reason = decide(hypotheses, settings)
    shared = overlap(a, b, hypotheses[0].pose) if hypotheses else 0.0
    if kind != "merged":
        return _result(kind, reason, hypotheses, a, b, None, shared)
    against = against_m(a, b, hypotheses[0].pose, None, settings)
    bent = _bent(a, b, hypotheses[0], against, settings)
    kind, reason = _doubted(a, b, hypotheses, against, bent, shared, settings) or (kind, reason)
    return _result(kind, reason, hypotheses, a, b, bent, shared)


def track(a: MatchMap, b: MatchMap, transform: ArrayLike, *, settings: FusionSettings | None = None) -> Match:
    """Refine and re-verify a decided transform after the maps have changed; ambiguity is not looked for again.

    Evidence against it comes back as another kind than `merged`: then the pair is to be matched anew.
    """
    settings = settings or FusionSettings()
    refusal = _refusal(a, b, settings)
    if refusal is not None:
        return refusal
    hypothesis = judge(a, b, np.asarray(transform, np.float64), settings)
    if judge_alone(hypothesis, settings)[0] != "merged":
        hypothesis = straighten(a, b, hypothesis, settings)
    kind, reason = judge_alone(hypothesis, settings)
    bent = None
    if kind == "merged":
        bent = _bent(a, b, hypothesis, against_m(a, b, hypothesis.pose, None, settings), settings)
    return _result(kind, reason, [hypothesis], a, b, bent, overlap(a, b, hypothesis.pose))


def _doubted(
    a: MatchMap,
    b: MatchMap,
    hypotheses: list[Hypothesis],
    against: float,
    bent: Bend | None,
    shared: float,
    settings: FusionSettings,
) -> tuple[VerdictKind, str] | None:
    """Why a placement is not to be believed although nothing speaks against it, None when it is.

    `against` is the wall in m that contradicts it as it is.
    """
    if shared >= settings.plain_overlap or not settings.min_distinction_m:
        return None
    best = hypotheses[0]
    detail, lead = detail_m(a, b, best.pose, settings), best.score * (1 - runner_up(hypotheses))
    if bent is not None:
        against = min(against, against_m(a, b, best.pose, bent, settings))
    if distinction_m(detail, lead, against) >= settings.min_distinction_m:
        return None
    return (
        "ambiguous",
        f"only {detail:.1f} m of wall agree beyond four straight lines, others come within {lead:.0f} m of its score, "
        f"and {against:.1f} m of wall stand where the other map is free: any place of this shape would fit",
    )


def _refusal(a: MatchMap, b: MatchMap, settings: FusionSettings) -> Match | None:
    """The verdict on maps that hold too little to be compared."""
    if a.resolution != b.resolution:
        raise Unmergeable(f"maps of {a.resolution} and {b.resolution} m/cell: render one at the other's resolution")
    shortest = min(a.wall_m, b.wall_m)
    if shortest < settings.min_walls_m:
        return Match("insufficient", f"a map with {shortest:.1f} m of wall; {settings.min_walls_m:.1f} m are needed")
    return None


def _result(
    kind: VerdictKind,
    reason: str,
    hypotheses: list[Hypothesis],
    a: MatchMap,
    b: MatchMap,
    bent: Bend | None,
    shared: float,
) -> Match:
    if not hypotheses:
        return Match(kind, reason)
    best, merged = hypotheses[0], kind == "merged"
    return Match(
        kind=kind,
        reason=reason,
        transform=best.pose if merged else None,
        information=loosened(best.information, b, best.pose, bent) if merged else None,
        overlap=shared,
        agreement=best.evidence.agreement,
        conflict=best.evidence.conflict,
        runner_up=runner_up(hypotheses),
        score=best.score,
        hypotheses=tuple(hypotheses),
    )


def _bent(a: MatchMap, b: MatchMap, best: Hypothesis, against: float, settings: FusionSettings) -> Bend | None:
    """How b is bent in a, None when it fits as it is: `against` is the wall in m that contradicts it so."""
    if best.bent is not None:
        return best.bent
    fits = best.evidence.agreement >= STRAIGHT_SHARE and not against
    return None if fits else bend(a, b, best.pose, settings)
