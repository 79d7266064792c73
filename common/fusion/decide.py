"""From weighed hypotheses to a verdict: merged only when the evidence is ample, coherent and alone."""

from __future__ import annotations

import numpy as np

from common.fusion.hypotheses import Hypothesis
from common.fusion.settings import FusionSettings
from common.wire.edge import VerdictKind


def runner_up(hypotheses: list[Hypothesis]) -> float:
    """Score of the second of the distinct hypotheses over that of the first, 0 when there is none."""
    if len(hypotheses) < 2 or hypotheses[0].score <= 0:
        return 0.0
    return max(0.0, hypotheses[1].score / hypotheses[0].score)


def decide(hypotheses: list[Hypothesis], settings: FusionSettings) -> tuple[VerdictKind, str]:
    """The verdict on the best hypothesis given the others (best first), and the reason for it."""
    if not hypotheses:
        return "no_overlap", "no placement of one map on the other was found"
    best = hypotheses[0]
    kind, reason = judge_alone(best, settings)
    if kind != "merged":
        return kind, reason
    ratio = runner_up(hypotheses)
    if ratio > settings.max_runner_up:
        return "ambiguous", f"another placement scores {ratio:.0%} of the best: the place looks alike in two ways"
    sigma = weakest_sigma(best)
    if sigma > settings.max_sigma_m:
        return "ambiguous", f"one map can slide on the other: {sigma:.2f} m uncertain in one direction"
    return "merged", reason


def judge_alone(hypothesis: Hypothesis, settings: FusionSettings) -> tuple[VerdictKind, str]:
    """What would be decided if there were no other hypothesis."""
    evidence = hypothesis.evidence
    if evidence.overlap_m2 < settings.min_overlap_m2 or evidence.agreeing_m < settings.min_agreeing_m:
        shared = f"{evidence.overlap_m2:.0f} m^2 and {evidence.agreeing_m:.1f} m of agreeing wall"
        return "no_overlap", f"the best placement shares {shared}: too little"
    if evidence.agreement < settings.min_agreement:
        return "no_overlap", f"only {evidence.agreement:.0%} of the walls in the best placement's overlap agree"
    if evidence.blob_m > settings.max_blob_m:
        return "conflict", f"{evidence.blob_m:.1f} m of connected wall stand in the other map's free space"
    if evidence.conflict > settings.max_conflict:
        return "conflict", f"{evidence.conflict:.0%} of the walls in the overlap stand in free space"
    return (
        "merged",
        f"{evidence.agreement:.0%} of {evidence.judged_m:.0f} m of wall agree, {evidence.conflict:.1%} contradict",
    )


def weakest_sigma(hypothesis: Hypothesis) -> float:
    """Standard deviation (m) of the translation in its least certain direction."""
    covariance = np.linalg.inv(hypothesis.information + 1e-6 * np.eye(3))
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance[:2, :2])[-1], 0.0)))
