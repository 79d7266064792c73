"""Robots that maps show where they stood are no contradictions between these maps."""

import numpy as np
from drawn_worlds import RESOLUTION, apartment, blank, wall

from common.fusion.evidence import weigh
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings
from common.geometry.se2 import IDENTITY
from common.grid import Grid
from common.grid.raster import Raster
from common.grid.standing import MarkedMap, stands
from common.grid.tiles import decode_occupancy, encode_occupancy

STANDS = ((4.0, 2.0), (4.0, 2.45), (4.4, 2.2))


def test_the_other_maps_picture_of_a_robot_is_no_contradiction_where_that_robot_stood() -> None:
    free = blank(8, 6)
    wall(free, 2, 0, 2, 3)
    seen = free.copy()
    for x, y in STANDS:
        for dx in (-0.15, 0.15):
            wall(seen, x + dx, y - 0.15, x + dx, y + 0.15)
    grid = Grid.from_dense(free, (0, 0), RESOLUTION)
    rows = [[10 * k + s, x + 0.5, y + 0.5, 0.0] for k, (x, y) in enumerate(STANDS) for s in (0.0, 3.0)]
    shown = MarkedMap(RESOLUTION, 0)
    shown.follow(grid, stands(np.array(rows)))
    other = MatchMap.from_grid(Grid.from_dense(seen, (0, 0), RESOLUTION))
    plain = weigh(MatchMap.from_grid(grid), other, IDENTITY, FusionSettings())
    told = weigh(MatchMap.from_grid(shown.grid), other, IDENTITY, FusionSettings())
    assert plain.blob_m > 0.5
    assert told.conflicting_m == 0
    assert told.agreeing_m == plain.agreeing_m


def test_a_sketch_and_the_counts_that_it_is_of_make_the_same_map_for_matching() -> None:
    shown, sketch, received = MarkedMap(RESOLUTION, 0), Raster(RESOLUTION), Raster(RESOLUTION)
    shown.follow(Grid.from_dense(apartment(3), (0, 0), RESOLUTION), np.array([[4.0, 5.5]]))
    sketch.follow(shown.grid)
    received.replace((key, decode_occupancy(encode_occupancy(cells))) for key, cells in sketch.tiles.items())
    from_counts, from_sketch = MatchMap.from_grid(shown.grid), MatchMap.of(*received.dense(), RESOLUTION)
    assert (from_counts.ground == 1).sum() > 100
    assert not (from_counts.occupancy == 1).any()
    assert np.array_equal(from_counts.ground, from_sketch.ground)
    assert np.array_equal(from_counts.occupancy, from_sketch.occupancy)
