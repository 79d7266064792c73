"""From weighed hypotheses to a verdict: merged only when the evidence is ample, coherent and alone."""

from __future__ import annotations

from common.fusion.hypotheses import Hypothesis
from common.fusion.settings import FusionSettings
from common.wire.edge import VerdictKind

NOISE_M, NOISE = 0.4, 0.01
"""length of connected contradicting wall that is not yet a thing, and share of scattered contradictions that may differ
by chance"""
TWIN = 0.3
"""share of the best's score that another placement must have: where maps hardly overlap little can contradict"""


def runner_up(hypotheses: list[Hypothesis]) -> float:
    """Score of the best of the other hypotheses over that of the first, 0 when there is none."""
    if len(hypotheses) < 2 or hypotheses[0].score <= 0:
        return 0.0
    return max(0.0, max(one.score for one in hypotheses[1:]) / hypotheses[0].score)


def decide(hypotheses: list[Hypothesis], settings: FusionSettings) -> tuple[VerdictKind, str]:
    """The verdict on the best hypothesis given the others (best first), and the reason for it."""
    if not hypotheses:
        return "no_overlap", "no placement of one map on the other was found"
    best = hypotheses[0]
    kind, reason = judge_alone(best, settings)
    if kind != "merged":
        return kind, reason
    ratio = runner_up(hypotheses)
    if ratio > _tolerated(best, ratio, settings):
        return "ambiguous", f"another placement scores {ratio:.0%} of the best: the place looks alike in two ways"
    twin = _twin(hypotheses, settings)
    if twin is not None:
        return "ambiguous", (
            f"another placement, {twin.score / best.score:.0%} of the best by its overlap, has no more against it: "
            "the place looks alike in two ways"
        )
    if best.grip_m < (settings.min_bent_grip_m if best.bent else settings.min_grip_m):
        return "ambiguous", f"only {best.grip_m:.1f} m of wall keep one map from sliding along the other"
    return "merged", reason


def judge_alone(hypothesis: Hypothesis, settings: FusionSettings) -> tuple[VerdictKind, str]:
    """What would be decided if there were no other hypothesis."""
    evidence, bent = hypothesis.evidence, hypothesis.bent is not None
    told = f"{evidence.agreement:.0%} of {evidence.judged_m:.0f} m of wall agree, {evidence.conflict:.1%} contradict"
    told += " once the bending of the maps is followed" if bent else ""
    score = settings.min_bent_score_m if bent else settings.min_score_m
    if evidence.overlap_m2 < settings.min_overlap_m2 or hypothesis.score < settings.min_score_m:
        return "no_overlap", f"the best placement shares too little: {evidence.overlap_m2:.0f} m^2, {told}"
    if evidence.blob_m > settings.max_blob_m + (settings.bent_blob * evidence.agreeing_m if bent else 0.0):
        return "conflict", f"{evidence.blob_m:.1f} m of connected wall stand in the other map's free space; {told}"
    quality = settings.min_bent_quality if bent else settings.min_quality
    if hypothesis.score < max(score, quality * evidence.judged_m):
        return "conflict", f"too much speaks against the best placement: {told}"
    return "merged", told


def _tolerated(best: Hypothesis, ratio: float, settings: FusionSettings) -> float:
    """How good a runner-up may be."""
    if best.bent is not None:
        return settings.max_bent_runner_up
    clear = best.score * (1 - ratio) >= settings.clear_lead_m
    return settings.max_runner_up_ever if clear else settings.max_runner_up


def _twin(hypotheses: list[Hypothesis], settings: FusionSettings) -> Hypothesis | None:
    """The first of the other hypotheses that would do alone, has no more against it than the best, and is no dwarf.

    Where rooms repeat themselves, the largest overlap scores highest, right or not: scores cannot tell. What stands in
    one room and not in the other can, and that is a contradiction.
    """
    best = hypotheses[0].evidence
    blob_m, conflict = max(best.blob_m, NOISE_M), best.conflict + NOISE
    for one in hypotheses[1:]:
        told = one.evidence
        if one.score < TWIN * hypotheses[0].score:
            continue
        if told.conflict <= conflict and judge_alone(one, settings)[0] == "merged" and told.blob_m <= blob_m:
            return one
    return None
