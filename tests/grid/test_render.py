"""Rendering resamples once: identity is exact, walls stay thin and closed, bits do not depend on chance."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import RESOLUTION, room

from common.errors import Unmergeable
from common.grid import Grid
from common.grid.render import render

poses = st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-math.pi, math.pi))


def test_rendering_by_the_identity_changes_nothing() -> None:
    assert render(room(cut_off=True), (0, 0, 0), RESOLUTION).digest() == room(cut_off=True).digest()


@given(st.integers(-500, 500), st.integers(-500, 500))
@settings(max_examples=20, deadline=None)
def test_whole_cell_shifts_and_back_change_nothing(i: int, j: int) -> None:
    there = render(room(cut_off=True), (i * RESOLUTION, j * RESOLUTION, 0), RESOLUTION)
    assert render(there, (-i * RESOLUTION, -j * RESOLUTION, 0), RESOLUTION).digest() == room(cut_off=True).digest()


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_quarter_turns_keep_every_count(quarter: int) -> None:
    turned = render(room(cut_off=True), (0, 0, quarter * math.pi / 2), RESOLUTION)
    assert render(turned, (0, 0, -quarter * math.pi / 2), RESOLUTION).digest() == room(cut_off=True).digest()


@given(poses)
@settings(max_examples=40, deadline=None)
def test_walls_stay_closed_and_thin_at_every_angle(pose: tuple[float, float, float]) -> None:
    before, _ = room(cut_off=True).occupancy()
    after, _ = render(room(cut_off=True), pose, RESOLUTION).occupancy()
    _, labels = cv2.connectedComponents((after == 0).astype(np.uint8), connectivity=4)
    rooms = np.sort(np.bincount(labels[after == 0]))[::-1][:2]
    assert rooms[1] > 500, "the triangle behind the diagonal wall has joined the room"
    assert (after == 100).sum() <= 1.45 * (before == 100).sum()


@given(poses)
@settings(max_examples=20, deadline=None)
def test_a_finer_map_keeps_its_walls_on_a_coarser_lattice(pose: tuple[float, float, float]) -> None:
    after, _ = render(room(cut_off=True), pose, 2 * RESOLUTION).occupancy()
    _, labels = cv2.connectedComponents((after == 0).astype(np.uint8), connectivity=4)
    assert np.sort(np.bincount(labels[after == 0]))[::-1][1] > 100


@given(poses)
@settings(max_examples=20, deadline=None)
def test_hits_never_exceed_visits_and_nothing_is_invented(pose: tuple[float, float, float]) -> None:
    counts, _ = render(room(cut_off=True), pose, RESOLUTION).dense()
    assert (counts[0] <= counts[1]).all()
    assert set(np.unique(counts)) <= {0, 9}
    known = room(cut_off=True).dense()[0][1].astype(bool).sum()
    assert abs(int((counts[1] > 0).sum()) - int(known)) < 0.05 * known


def test_an_empty_grid_renders_empty() -> None:
    assert render(Grid(0.1), (1, 2, 3), 0.05).tiles == {}


@pytest.mark.parametrize("pose", [(math.nan, 0, 0), (math.inf, 0, 0), (1e12, 0, 0)])
def test_impossible_transforms_are_refused(pose: tuple[float, float, float]) -> None:
    with pytest.raises(Unmergeable):
        render(room(cut_off=True), pose, RESOLUTION)
