"""Matching finds the place, says when it cannot know it, and never takes one place for another."""

import numpy as np
import pytest
from drawn_worlds import RESOLUTION, apartment, blank, mapped, row_of_rooms, symmetric_hall, wall
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import Unmergeable
from common.fusion.match import Match, match, track
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.geometry import apply, between, compose, wrap

HOME = np.array([3.0, 2.0, 0.3])
poses = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-np.pi, np.pi))


def assert_right(result: Match, truth: np.ndarray, b: MatchMap) -> None:
    assert result.kind == "merged", result.reason
    assert result.transform is not None
    middle = b.walls.points.mean(axis=0)[None]
    assert np.linalg.norm(apply(result.transform, middle) - apply(truth, middle)) < 0.05
    assert abs(wrap(result.transform[2] - truth[2])) < 0.01


@given(poses, st.integers(0, 5))
@settings(max_examples=8, deadline=None)
def test_two_robots_of_one_apartment_are_merged_wherever_they_started(
    frame: tuple[float, float, float], seed: int
) -> None:
    world = apartment(seed)
    a, b = mapped(world, HOME, (0, 11), seed=1), mapped(world, frame, (5, 16), seed=2)
    assert_right(match(a, b), between(HOME, frame), b)


def test_a_quarter_of_overlap_is_enough() -> None:
    frame = np.array([-4.0, 7.0, 2.0])
    world = apartment(3, width_m=20)
    a, b = mapped(world, HOME, (0, 11.5)), mapped(world, frame, (8.5, 20), seed=5)
    assert_right(match(a, b), between(HOME, frame), b)


@pytest.mark.parametrize("seed", range(6))
def test_different_buildings_are_never_merged(seed: int) -> None:
    a, b = mapped(apartment(seed), HOME), mapped(apartment(seed + 50), (1, 2, 2))
    result = match(a, b)
    assert result.kind != "merged"
    assert result.transform is None


def test_a_symmetric_building_is_ambiguous() -> None:
    result = match(mapped(symmetric_hall(), HOME), mapped(symmetric_hall(), (-3, 4, 1.2), seed=3))
    assert result.kind == "ambiguous", result.reason
    assert result.runner_up > 0.8


def test_a_row_of_equal_rooms_is_ambiguous_though_a_larger_overlap_fits() -> None:
    a, b = mapped(row_of_rooms(), HOME, (0, 12), seed=1), mapped(row_of_rooms(), (12, 3, 1), (9, 21), seed=2)
    result = match(a, b)
    assert result.kind == "ambiguous", result.reason
    assert "no more against it" in result.reason


@pytest.mark.parametrize("x", [9.6, 9.8, 10.0])
def test_a_closet_that_one_room_lacks_is_not_outvoted_by_a_larger_overlap(x: float) -> None:
    counts, frame = row_of_rooms(), np.array([12.0, 3.0, 1.0])
    for ends in ((x, 4.9, x + 0.8, 4.9), (x, 4.9, x, 6), (x + 0.8, 4.9, x + 0.8, 6)):
        wall(counts, *ends)
    result = match(mapped(counts, HOME, (0, 12), seed=1), mapped(counts, frame, (9, 21), seed=2))
    assert result.kind != "merged" or result.transform == pytest.approx(between(HOME, frame), abs=0.05)


@pytest.mark.parametrize("seed", range(10))
def test_rows_of_rooms_with_closets_anywhere_are_never_merged_wrongly(seed: int) -> None:
    rng, counts, frame = np.random.default_rng(seed), row_of_rooms(), np.array([12.0, 3.0, 1.0])
    for _ in range(rng.integers(0, 4)):
        (x, y), (w, h) = rng.uniform((0, 1.2), (19.5, 4.8)), rng.uniform(0.4, 1.1, 2)
        for ends in ((x, y, x + w, y), (x, y + h, x + w, y + h), (x, y, x, y + h), (x + w, y, x + w, y + h)):
            wall(counts, *ends)
    reach = rng.uniform(9, 15, 2)
    a, b = mapped(counts, HOME, (0, reach[0]), seed=1), mapped(counts, frame, (21 - reach[1], 21), seed=2)
    result = match(a, b)
    if result.kind == "merged":
        assert_right(result, between(HOME, frame), b)


def test_a_bare_corridor_is_not_pinned_along_its_length() -> None:
    counts = blank(30, 2.5)
    a, b = mapped(counts, HOME, (2, 18)), mapped(counts, (0, 0, 1.0), (10, 28), seed=2)
    assert match(a, b).kind != "merged"


def test_a_map_with_hardly_any_wall_is_insufficient() -> None:
    crumb = blank(1, 1)
    result = match(mapped(crumb, HOME), mapped(apartment(0), HOME))
    assert result.kind == "insufficient"
    assert "m of wall" in result.reason


def test_an_empty_map_is_insufficient() -> None:
    empty = MatchMap.of(np.full((30, 40), -1, np.int8), (0, 0), RESOLUTION)
    assert match(empty, mapped(apartment(0), HOME)).kind == "insufficient"


def test_phantom_robots_do_not_prevent_a_merge() -> None:
    world, haunted = apartment(4), apartment(4)
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(1, 10, (12, 2)):
        for k in range(4):
            wall(haunted, x, y + 0.05 * k, x + 0.2, y + 0.05 * k)
    frame = (2.0, -6.0, -2.2)
    a, b = mapped(world, HOME, (0, 12)), mapped(haunted, frame, (4, 16), seed=2)
    assert_right(match(a, b), between(HOME, frame), b)


def test_a_verdict_depends_on_nothing_but_the_maps() -> None:
    frame = (-4.0, 7.0, 2.0)
    a, b = mapped(apartment(1), HOME, (0, 11)), mapped(apartment(1), frame, (5, 16), seed=2)
    first = match(a, b)
    match(b, mapped(apartment(2), HOME), seed=5)
    again = match(MatchMap.of(a.occupancy, a.origin_cell, a.resolution), b)
    assert first.transform is not None
    assert first.transform.tobytes() == again.transform.tobytes()
    assert (first.score, first.runner_up, first.overlap) == (again.score, again.runner_up, again.overlap)


def test_a_right_prior_is_taken_and_a_wrong_one_does_no_harm() -> None:
    frame = np.array([-4.0, 7.0, 2.0])
    a, b = mapped(apartment(1), HOME, (0, 11)), mapped(apartment(1), frame, (5, 16), seed=2)
    truth = between(HOME, frame)
    for prior in (truth, compose(truth, (5.0, 1.0, 2.0))):
        assert_right(match(a, b, prior=prior), truth, b)


@given(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-0.02, 0.02))
@settings(max_examples=10, deadline=None)
def test_tracking_sharpens_a_decided_transform(dx: float, dy: float, turn: float) -> None:
    frame = np.array([-4.0, 7.0, 2.0])
    a, b = mapped(apartment(1), HOME, (0, 11)), mapped(apartment(1), frame, (5, 16), seed=2)
    truth = between(HOME, frame)
    assert_right(track(a, b, compose((dx, dy, turn), truth)), truth, b)


def test_tracking_undoes_a_merge_that_the_maps_have_come_to_contradict() -> None:
    a, b = mapped(apartment(1), HOME), mapped(apartment(60), HOME)
    assert track(a, b, np.zeros(3)).kind != "merged"


def test_maps_of_different_resolutions_are_refused() -> None:
    a = mapped(apartment(1), HOME)
    with pytest.raises(Unmergeable, match="render"):
        match(a, MatchMap.of(a.occupancy, a.origin_cell, 0.1))


def test_a_match_tells_itself_as_a_wire_verdict() -> None:
    a, b = mapped(apartment(1), HOME, (0, 11)), mapped(apartment(1), HOME, (5, 16), seed=2)
    verdict = match(a, b).verdict("ant", "bee", (3, 4))
    assert (verdict.kind, verdict.versions) == ("merged", (3, 4))
    assert verdict.transform == pytest.approx((0, 0, 0), abs=0.02)
    assert 0.1 < verdict.overlap < 0.5


def test_settings_refuse_what_they_do_not_know() -> None:
    with pytest.raises(ValueError, match="toleranz"):
        FusionSettings.model_validate({"toleranz_m": 1})
