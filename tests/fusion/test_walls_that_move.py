"""What the frame bench takes for a move of walls, and what it does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.frame import patches
from common.fusion.matchmap import MatchMap

CELL = 0.05


def room(*, right: int = 159) -> NDArray[np.int8]:
    """8 x 6 m seen from within, walls one cell thick, unknown outside; its right wall may stand elsewhere."""
    cells = np.full((140, 190), -1, np.int8)
    cells[10:130, 10 : right + 1] = 100
    cells[11:129, 11:right] = 0
    return cells


def moves(before: NDArray[np.int8], after: NDArray[np.int8]) -> NDArray[np.float64]:
    return patches(MatchMap.of(before, (0, 0), CELL), MatchMap.of(after, (0, 0), CELL))


def test_walls_that_stand_have_not_moved() -> None:
    assert len(moves(room(), room())) >= 8
    assert moves(room(), room()).max() == 0


def test_one_wall_that_moves_by_a_cell_is_found_either_way() -> None:
    for before, after in ((room(), room(right=160)), (room(right=160), room())):
        found = moves(before, after)
        assert 2 <= np.count_nonzero(found > 0.025) < len(found) / 2
        assert abs(found.max() - CELL) < 0.01


def test_a_map_that_moves_as_a_whole_is_found() -> None:
    assert moves(room(), np.roll(room(), 1, axis=1)).max() > 0.04


def test_a_face_that_comes_before_a_known_wall_moves_it() -> None:
    after = room()
    after[10:130, 157:159] = 100
    assert moves(room(), after).max() > 0.025


def test_the_other_face_of_a_wall_moves_nothing_when_it_is_seen_at_last() -> None:
    for gap in (0, 1, 2):
        after = room()
        after[10:130, 160 + gap] = 100
        after[10:130, 161 + gap :] = 0
        assert moves(room(), after).max() < 0.005
