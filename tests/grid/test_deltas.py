"""A reader that applies deltas holds the same grid as one that takes the whole."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from common.grid import TILE, Grid

changes = st.lists(
    st.lists(st.tuples(st.integers(-2, 2), st.integers(-2, 2), st.integers(0, 5)), min_size=1, max_size=4),
    min_size=1,
    max_size=8,
)


@given(changes, st.data())
@settings(max_examples=60, deadline=None)
def test_applying_deltas_gives_the_same_grid_as_the_whole(
    steps: list[list[tuple[int, int, int]]], data: st.DataObject
) -> None:
    owner, reader, have = Grid(0.05), Grid(0.05), 0
    for step in steps:
        owner.replace(((x, y), np.full((2, TILE, TILE), value, np.uint16)) for x, y, value in step)
        if data.draw(st.booleans()):
            reader.replace((key, owner.tiles[key]) for key in owner.delta(have))
            have = owner.version
    reader.replace((key, owner.tiles[key]) for key in owner.delta(have))
    assert reader.digest() == owner.digest()
    assert owner.delta(owner.version) == []


def test_an_unchanged_tile_keeps_its_version() -> None:
    grid, tile = Grid(0.05), np.ones((2, TILE, TILE), np.uint16)
    grid.replace([((0, 0), tile)])
    grid.replace_if_different([((0, 0), tile.copy()), ((1, 0), tile)])
    assert grid.delta(1) == [(1, 0)]


def test_a_dense_array_survives_being_cut_into_tiles() -> None:
    counts = np.random.default_rng(0).integers(0, 9, (2, 70, 150)).astype(np.uint16)
    grid = Grid.from_dense(counts, (-71, 130), 0.05)
    dense, (x0, y0) = grid.dense()
    assert np.array_equal(dense[:, 130 - y0 : 200 - y0, -71 - x0 : 79 - x0], counts)
    assert dense.sum() == counts.sum()
