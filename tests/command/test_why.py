"""`recslam why` tells what was decided about a pair, by whom, on what evidence, and what follows."""

from __future__ import annotations

import json

import numpy as np

from common.wire import FixedPose, PairVerdict, Placed, Transforms
from services.command.why import as_data, as_lines

MERGED = PairVerdict(
    a="r1", b="r2", kind="merged", versions=(3, 4), transform=(1.0, 2.0, np.pi / 2), final=True,
    overlap=0.25, agreement=0.93, conflict=0.018, runner_up=0.2, reason="93% of 296 m of wall agree",
)  # fmt: skip
AMBIGUOUS = PairVerdict(a="r1", b="r3", kind="ambiguous", versions=(3, 1), runner_up=0.97, reason="looks alike")


def placed(component: str) -> Placed:
    return Placed(transform=FixedPose.of(0.0, 0.0, 0.0), component=component, version=1)


def world(**components: str) -> Transforms:
    robots = {name: placed(component) for name, component in components.items()}
    return Transforms(world_epoch=1, final=True, resolution=0.05, robots=robots, components=(), reason="")


def test_a_merged_pair_is_told_with_its_evidence_and_transform() -> None:
    said = "\n".join(as_lines(MERGED, "cloud", world(r1="r1", r2="r1")))
    for part in ("r1 - r2: merged (final, decided by cloud)", "0.250 of 0.5", "93%", "1.8%", "20%", "90.00 degrees"):
        assert part in said
    assert said.endswith("they lie in one component")


def test_an_ambiguous_pair_that_others_hold_together_is_told_so() -> None:
    assert as_lines(AMBIGUOUS, "edge/e1", world(r1="r1", r3="r1"))[-1].endswith("by other pairs or by start poses")
    assert "different components" in as_lines(AMBIGUOUS, "edge/e1", world(r1="r1", r3="r3"))[-1]
    assert "r3 not placed yet" in as_lines(AMBIGUOUS, "edge/e1", world(r1="r1"))[-1]


def test_programs_are_told_the_same() -> None:
    data = json.loads(json.dumps(as_data(AMBIGUOUS, "edge/e1", world(r1="r1", r3="r3"))))
    assert (data["kind"], data["owner"], data["one_component"]) == ("ambiguous", "edge/e1", False)
    assert as_data(AMBIGUOUS, "edge/e1", None)["one_component"] is None
