"""The overlap matrix says how much of two maps is the same, and how that is known."""

from __future__ import annotations

import numpy as np
import pytest

from services.scheduler.graph import QUANTUM
from services.scheduler.overlap import (
    SOURCES,
    Footprint,
    cells_of_points,
    cells_of_raster,
    cells_of_route,
    lattice_cells,
    overlap_matrix,
)


def square(x: float, y: float, side: int) -> np.ndarray:
    return cells_of_raster(np.ones((side, side), dtype=bool), 1.0, (x, y, 0.0))


def test_the_weight_is_the_shared_part_of_both_areas() -> None:
    overlap = overlap_matrix([Footprint("a", "w", square(0, 0, 10)), Footprint("b", "w", square(5, 0, 10))])
    assert overlap.weights[0, 1] == 50 / 200
    same = overlap_matrix([Footprint("a", "w", square(-3, 2, 10)), Footprint("b", "w", square(-3, 2, 10))])
    assert same.weights[0, 1] == 0.5


def test_weights_are_symmetric_quantised_and_zero_on_the_diagonal() -> None:
    rng = np.random.default_rng(0)
    footprints = [Footprint(f"r{i}", "w", cells_of_points(rng.uniform(0, 12, (90, 2)))) for i in range(9)]
    weights = overlap_matrix(footprints).weights
    assert np.array_equal(weights, weights.T)
    assert not weights.diagonal().any()
    assert np.array_equal(np.rint(weights / QUANTUM) * QUANTUM, weights)
    sets = [set(footprint.cells.tolist()) for footprint in footprints]
    assert weights[2, 7] == pytest.approx(len(sets[2] & sets[7]) / (len(sets[2]) + len(sets[7])), abs=QUANTUM)


def test_footprints_in_different_frames_are_unknown_to_each_other() -> None:
    footprints = [Footprint("a", "one", square(0, 0, 4)), Footprint("b", "two", square(0, 0, 4))]
    overlap = overlap_matrix(footprints)
    assert overlap.weights[0, 1] == 0
    assert SOURCES[overlap.source[0, 1]] == "unknown"
    assert not set(lattice_cells(footprints)[0].tolist()) & set(lattice_cells(footprints)[1].tolist())


def test_an_entry_is_as_sure_as_the_weaker_of_its_footprints() -> None:
    footprints = [
        Footprint("a", "w", square(0, 0, 4), "map"),
        Footprint("b", "w", square(1, 0, 4), "start"),
        Footprint("c", "w", square(2, 0, 4), "map"),
        Footprint("d", "w", np.empty(0, dtype=np.int64), "map"),
    ]
    overlap = overlap_matrix(footprints)
    assert [SOURCES[s] for s in overlap.source[0]] == ["map", "start", "map", "unknown"]
    assert overlap.sources() == {"unknown": 3, "start": 2, "map": 1}


def test_a_turned_raster_covers_the_same_place_as_its_cells() -> None:
    known = np.zeros((6, 8), dtype=bool)
    known[1, 5] = known[4, 2] = True
    turned = cells_of_raster(known, 1.0, (10.0, -3.0, np.pi / 2))
    assert np.array_equal(turned, cells_of_points([[10 - 1.5, -3 + 5.5], [10 - 4.5, -3 + 2.5]]))


def test_a_fine_raster_covers_each_coarse_cell_it_touches_once() -> None:
    assert cells_of_raster(np.ones((40, 60), dtype=bool), 0.05).size == 2 * 3


def test_a_route_sweeps_the_sensor_disc_along_its_legs() -> None:
    disc = cells_of_route([[0.0, 0.0]], 5.0)
    assert disc.size == pytest.approx(np.pi * 25, rel=0.1)
    swept = cells_of_route([[0.0, 0.0], [20.0, 0.0]], 5.0)
    assert swept.size == pytest.approx(np.pi * 25 + 200, rel=0.1)
    assert np.isin(disc, swept).all()


def test_nobody_and_nothing_make_an_empty_matrix() -> None:
    assert overlap_matrix([]).weights.shape == (0, 0)
    lonely = overlap_matrix([Footprint("a", "w", np.empty(0, dtype=np.int64), "unknown")])
    assert lonely.weights.tolist() == [[0.0]]
