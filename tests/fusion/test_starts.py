"""Start poses that are a little off tell which of several placements is meant, and never more than they know."""

import numpy as np
import pytest
from drawn_worlds import Counts, blank, mapped, symmetric_hall, wall

from common.fusion.settings import FusionSettings
from common.fusion.starts import meant, told_by_starts
from common.geometry import between, compose
from common.wire.edge import PairVerdict, VerdictKind

SETTINGS = FusionSettings()
A, B = np.array([2.0, 2.0, 0.3]), np.array([11.0, 8.0, 2.0])


def comb() -> Counts:
    """A corridor that looks the same every metre."""
    counts = blank(22, 3)
    for x in range(1, 22):
        wall(counts, x, 0, x, 0.6)
        wall(counts, x, 2.4, x, 3)
    return counts


@pytest.mark.parametrize("degrees", [-8.0, -5.0, 5.0, 8.0])
def test_a_heading_off_by_degrees_is_found_right_across_the_hall(degrees: float) -> None:
    a, b = mapped(symmetric_hall(), A, seed=1), mapped(symmetric_hall(), B, seed=2)
    found = meant(a, b, A + np.array([0.1, -0.1, np.radians(degrees)]), B, SETTINGS)
    assert found is not None
    assert found.transform == pytest.approx(between(A, B), abs=0.02)


def pair(kind: VerdictKind) -> PairVerdict:
    return PairVerdict(a="a", b="b", kind=kind, versions=(1, 1), final=True, searched=True)


def test_of_places_that_conflict_the_one_that_start_poses_mean_is_taken_if_it_does_not() -> None:
    """The best placement that a search found may be of another room that looks alike."""
    maps = {"a": mapped(symmetric_hall(), A, seed=1), "b": mapped(symmetric_hall(), B, seed=2)}
    starts = {"a": A + np.array([0.1, -0.1, 0.05]), "b": B}
    found = told_by_starts([pair("conflict")], maps, starts, SETTINGS)
    assert found["a", "b"].transform == pytest.approx(between(A, B), abs=0.02)
    changed = symmetric_hall()
    wall(changed, 4, 3, 9, 3)
    wall(changed, 4, 7, 9, 7)
    maps["b"] = mapped(changed, B, seed=2)
    assert told_by_starts([pair("conflict")], maps, starts, SETTINGS) == {}


def test_start_poses_farther_off_than_they_can_be_tell_nothing() -> None:
    a, b = mapped(symmetric_hall(), A, seed=1), mapped(symmetric_hall(), B, seed=2)
    assert meant(a, b, A, B + np.array([0.0, 0.0, np.pi / 2]), SETTINGS) is None
    assert meant(a, b, A, B + np.array([2.5, 0.0, 0.0]), SETTINGS) is None


def test_between_two_places_that_fit_alike_nothing_is_told() -> None:
    left, right = np.array([8.0, 1.5, 0.0]), np.array([11.0, 1.5, 0.0])
    a, b = mapped(comb(), left, (3.5, 14.5), seed=1), mapped(comb(), right, (6.5, 17.5), seed=2)
    assert meant(a, b, left, compose(right, (0.5, 0.0, 0.0)), SETTINGS) is None
    near = meant(a, b, left, compose(right, (0.1, 0.05, 0.02)), SETTINGS)
    assert near is not None
    assert near.transform == pytest.approx(between(left, right), abs=0.03)


def test_maps_that_share_nothing_are_not_told_by_their_starts() -> None:
    left, right = np.array([3.0, 1.5, 0.0]), np.array([18.0, 1.5, 0.0])
    a, b = mapped(comb(), left, (0.5, 8.5)), mapped(comb(), right, (13.5, 21.5))
    assert meant(a, b, left, right, SETTINGS) is None
