"""Drawing scans into counts."""

from __future__ import annotations

import numpy as np
import pytest

from services.edge_worker.slam.raycast import HIT, NOWHERE, PASSED, UNSEEN, Canvas, trace

RESOLUTION = 0.05


def test_a_laser_on_the_border_of_two_cells_stays_within_its_patch() -> None:
    """-33.00000000000001 cells lie in cell -34, though the distance from the patch's lowest cell rounds to -33."""
    pose = np.array([8.89, -1.65, -1.57])
    bearings = np.radians(np.arange(-90.0, 90.0))
    ends = 3.6 * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    patch, x0, y0 = trace(pose, ends, np.empty((0, 2)), np.zeros(2), RESOLUTION, NOWHERE)
    row = int(np.floor(pose[1] / RESOLUTION)) - y0
    column = int(np.floor(pose[0] / RESOLUTION)) - x0
    assert patch[row, column] in (PASSED, HIT)


@pytest.mark.parametrize("seed", range(20))
def test_every_end_is_hit_and_every_ray_reaches_it_cell_by_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*np.rint(rng.uniform(-900, 900, 2)) * 0.01, rng.uniform(-np.pi, np.pi)])
    ends = rng.uniform(-6, 6, (1, 2))
    patch, x0, y0 = trace(pose, ends, np.empty((0, 2)), np.zeros(2), RESOLUTION, NOWHERE)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    end = (pose[:2] + np.array([c * ends[0, 0] - s * ends[0, 1], s * ends[0, 0] + c * ends[0, 1]])) / RESOLUTION
    start = pose[:2] / RESOLUTION
    first, last = np.floor(start).astype(int), np.floor(end).astype(int)
    assert patch[last[1] - y0, last[0] - x0] == HIT
    assert (patch == HIT).sum() == 1
    assert (patch > 0).sum() == np.abs(last - first).sum() + 1


def test_beams_that_graze_a_wall_do_not_eat_it() -> None:
    """Each passes the cells in which its neighbours may have met the wall; a beam far off still clears."""
    along = np.arange(4.0, 9.0, 0.25)
    wall = np.column_stack([along, np.full(len(along), 0.98)])
    patch, x0, y0 = trace(np.array([0.0, 0.01, 0.0]), wall, np.empty((0, 2)), np.zeros(2), RESOLUTION, NOWHERE)
    row = patch[19 - y0, int(4.0 / RESOLUTION) - x0 :]
    assert (row == HIT).sum() == len(along)
    assert not (row == PASSED).any()
    assert (patch[15 - y0] == PASSED).any()


def test_between_ends_on_one_surface_there_is_wall_and_elsewhere_nothing_is_known() -> None:
    ends = np.array([[2.0, -0.07], [2.0, 0.08], [2.0, 0.23]])
    joined = np.array([True, False, False])
    patch, x0, y0 = trace(np.array([0.0, 0.01, 0.0]), ends, np.empty((0, 2)), np.zeros(2), RESOLUTION, joined)
    column = patch[:, int(2.0 / RESOLUTION) - x0]
    assert [column[y - y0] for y in range(-2, 5)] == [HIT, HIT, HIT, HIT, UNSEEN, UNSEEN, HIT]


def test_a_scan_is_undone_exactly() -> None:
    rng = np.random.default_rng(3)
    canvas = Canvas(RESOLUTION)
    ends = rng.uniform(-6, 6, (50, 2)).astype(np.float32)
    for times in (1, -1):
        canvas.draw(np.array([0.3, 0.2, 1.0]), ends, np.zeros(2), ends[:5] * 2, times, rng.random(50) < 2)
    assert canvas.tiles
    assert not any(tile.any() for tile in canvas.tiles.values())
