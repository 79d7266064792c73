"""Overlap is what both maps know, over what either holds; footprints agree with it and add up."""

import numpy as np
import pytest
from drawn_worlds import apartment, mapped

from common.fusion.layout import Box, bounds, lay_out
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import FOOTPRINT_M, Footprints, overlap, shared_area
from common.geometry import IDENTITY, apply, between, compose

HOME, AWAY = np.array([3.0, 2.0, 0.3]), np.array([-4.0, 7.0, 2.0])


def halves() -> tuple[MatchMap, MatchMap, np.ndarray]:
    """Maps of 0-10 m and 6-16 m of one apartment, and the truth."""
    world = apartment(0)
    return mapped(world, HOME, (0, 10)), mapped(world, AWAY, (6, 16)), between(HOME, AWAY)


def test_a_map_overlaps_itself_by_one_half() -> None:
    a = mapped(apartment(0), HOME)
    assert overlap(a, a, IDENTITY) == pytest.approx(0.5, abs=0.01)


def test_four_shared_metres_of_ten_give_one_fifth() -> None:
    a, b, truth = halves()
    assert overlap(a, b, truth) == pytest.approx(0.2, abs=0.01)
    assert overlap(b, a, between(AWAY, HOME)) == pytest.approx(0.2, abs=0.01)
    assert overlap(a, b, compose((100, 0, 0), truth)) == 0


def test_shared_area_is_the_count_of_points_known_to_both() -> None:
    a, b, truth = halves()
    rows, columns = np.nonzero(b.occupancy != -1)
    points = apply(truth, b.origin + (np.stack([columns, rows], axis=1) + 0.5) * b.resolution)
    cells = np.floor((points - a.origin) / a.resolution).astype(int)
    inside = ((cells >= 0) & (cells < a.occupancy.shape[::-1])).all(axis=1)
    exact = (a.occupancy[cells[inside, 1], cells[inside, 0]] != -1).sum() * a.resolution**2
    assert shared_area(a, b, truth) == pytest.approx(exact, rel=0.02)


def test_footprints_give_the_same_overlap_and_a_union_below_the_sum() -> None:
    a, b, truth = halves()
    far = compose((200, 0, 0), truth)
    prints = Footprints.of([a, b, b], [IDENTITY, truth, far])
    weights = prints.weights()
    assert weights[0, 1] == pytest.approx(overlap(a, b, truth), abs=0.03)
    assert weights[0, 2] == weights[0, 0] == 0
    assert np.array_equal(weights, weights.T)
    assert prints.union_m2([0, 1]) == pytest.approx(16 * 12, rel=0.1)
    assert prints.union_m2() == pytest.approx(16 * 12 + 120, rel=0.1)


def test_footprints_of_nothing_are_empty() -> None:
    empty = MatchMap.of(np.full((5, 5), -1, np.int8), (0, 0), FOOTPRINT_M)
    prints = Footprints.of([empty, empty], [IDENTITY, IDENTITY])
    assert prints.union_m2() == 0
    assert not prints.weights().any()


def boxes_apart(boxes: dict[str, Box], places: dict[str, np.ndarray]) -> bool:
    moved = [
        (b.x0 + places[n][0], b.y0 + places[n][1], b.x1 + places[n][0], b.y1 + places[n][1]) for n, b in boxes.items()
    ]
    return not any(
        p[0] < q[2] and q[0] < p[2] and p[1] < q[3] and q[1] < p[3] for k, p in enumerate(moved) for q in moved[:k]
    )


def test_components_lie_apart_and_the_first_at_home() -> None:
    boxes = {"bee": Box(-5, -5, 10, 9), "ant": Box(0, 0, 20, 8), "cat": Box(3, 3, 4, 4)}
    places = lay_out(boxes)
    assert boxes_apart(boxes, places)
    assert not places["ant"].any()
    assert lay_out(dict(reversed(boxes.items())))["cat"].tolist() == places["cat"].tolist()


def test_places_are_kept_until_another_component_grows_into_them() -> None:
    boxes = {"ant": Box(0, 0, 20, 8), "bee": Box(0, 0, 5, 5)}
    before = lay_out(boxes)
    kept = {name: before[name] for name in boxes}
    assert np.array_equal(lay_out(boxes | {"ant": Box(-9, 0, 20, 30)}, kept)["bee"], before["bee"])
    grown = boxes | {"ant": Box(0, 0, 40, 8)}
    after = lay_out(grown, kept)
    assert boxes_apart(grown, after)
    assert not after["ant"].any()


def test_bounds_hold_all_known_cells() -> None:
    a, b, truth = halves()
    box = bounds([(a, IDENTITY), (b, truth)])
    points = np.concatenate([a.walls.points, apply(truth, b.walls.points)])
    assert (points > (box.x0, box.y0)).all()
    assert (points < (box.x1, box.y1)).all()
