"""Rooms that are merely of one shape are not taken for one room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from drawn_worlds import RESOLUTION, apartment, blank, mapped, wall

from common.fusion.bend import bend
from common.fusion.detail import against_m, detail_m, distinction_m
from common.fusion.match import match
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.geometry import between

LONG_M = 53.0
TRUSTING = FusionSettings(min_distinction_m=0.0)


def window(k: int, building: int = 3) -> MatchMap:
    """The k-th of overlapping stretches of a long building, in a frame of its own."""
    return mapped(apartment(building, width_m=LONG_M), frame_of(k), (6.0 * k, 6.0 * k + 11.0), seed=k)


def frame_of(k: int) -> np.ndarray:
    return np.array([5.0 * k, 1.0, 0.5 * k])


@pytest.mark.parametrize(("one", "other"), [(1, 4), (2, 7), (4, 7)])
def test_two_walls_and_two_cross_walls_are_no_reason_to_merge(one: int, other: int) -> None:
    a, b = window(one), window(other)
    assert match(a, b, settings=TRUSTING).kind == "merged"
    found = match(a, b)
    assert found.kind == "ambiguous"
    assert "beyond four straight lines" in found.reason


def test_what_neighbours_share_has_detail() -> None:
    a, b = window(3), window(4)
    assert match(a, b).kind == "merged"
    assert detail_m(a, b, between(frame_of(3), frame_of(4)), FusionSettings()) > 5.0


@pytest.mark.parametrize(("building", "one", "other"), [(1003, 0, 2), (1006, 2, 6), (1011, 1, 5)])
def test_a_door_in_another_place_outweighs_a_cross_wall_in_the_same(building: int, one: int, other: int) -> None:
    a, b = window(one, building), window(other, building)
    trusted = match(a, b, settings=TRUSTING)
    if trusted.transform is not None:
        assert detail_m(a, b, trusted.transform, FusionSettings()) > 1.0
    assert match(a, b).kind != "merged"


def test_detail_or_a_long_lead_sets_a_place_apart_and_a_door_elsewhere_does_not() -> None:
    least = FusionSettings().min_distinction_m
    assert distinction_m(4.0, 0.0, 0.0) >= least
    assert distinction_m(0.0, 10.0, 0.0) >= least
    assert distinction_m(1.0, 5.0, 0.0) < least
    assert distinction_m(4.0, 8.0, 0.8) < least


def test_doors_elsewhere_all_count_in_full_and_walls_that_are_merely_ragged_do_not() -> None:
    plain, settings = blank(8.0, 6.0), FusionSettings()
    one, other = plain.copy(), plain.copy()
    for counts, doors in ((one, (1.0, 4.0)), (other, (2.5, 6.0))):
        x = 0.0
        for door in (*doors, 8.0):
            wall(counts, x, 3.0, door, 3.0)
            x = door + 0.9
    frame = np.zeros(3)
    a, b, again = mapped(one, frame, seed=1), mapped(other, frame, seed=2), mapped(one, frame, seed=3)
    assert against_m(a, b, frame, None, settings) == pytest.approx(4 * 0.6, abs=0.9)
    assert against_m(a, again, frame, None, settings) == 0.0


def test_what_drift_explains_does_not_speak_against_a_place() -> None:
    counts, frame, settings = apartment(3, width_m=20.0), np.zeros(3), FusionSettings()
    rows, columns = np.mgrid[: counts.shape[1], : counts.shape[2]].astype(np.float32)
    columns -= np.float32(0.02) * np.maximum(columns - np.float32(10.0 / RESOLUTION), 0)
    stretched = np.stack([cv2.remap(plane, columns, rows, cv2.INTER_NEAREST) for plane in counts])
    a, b = mapped(counts, frame, seed=1), mapped(stretched, frame, seed=2)
    assert against_m(a, b, frame, None, settings) > 1.0
    assert against_m(a, b, frame, bend(a, b, frame, settings), settings) < 0.5
