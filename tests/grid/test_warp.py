"""A warp straightens a map while it is rendered: whole shifts are exact, walls stay closed, trajectories follow."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from rooms import RESOLUTION, room

from common.grid import Grid
from common.grid.render import render
from common.grid.warp import lattice, shift_at, shifts, straightened
from common.wire import Warp


def warp(x: np.ndarray, y: np.ndarray) -> Warp:
    """A lattice of 2 m around the room, with these shifts (rows, columns) in metres."""
    um = np.rint(np.stack(np.broadcast_arrays(x, y), axis=-1) * 1e6).astype(int)
    return Warp(spacing_m=2.0, x=-3, y=-1, columns=um.shape[1], shifts_um=tuple(um.ravel().tolist()))


def bend() -> Warp:
    """Up to 0.4 m across, as drift of the heading does it."""
    along = np.arange(9) * 2.0
    return warp(np.zeros((7, 9)), 0.0015 * along**2)


def test_a_warp_of_nothing_changes_no_bit() -> None:
    still = warp(np.zeros((7, 9)), np.zeros((7, 9)))
    assert render(room(), (3, 1, 0.7), RESOLUTION, still).digest() == render(room(), (3, 1, 0.7), RESOLUTION).digest()


def test_a_warp_by_whole_cells_is_a_translation() -> None:
    shifted = warp(np.full((7, 9), 6 * RESOLUTION), np.full((7, 9), -4 * RESOLUTION))
    moved = render(room(), (6 * RESOLUTION, -4 * RESOLUTION, 0), RESOLUTION)
    assert render(room(), (0, 0, 0), RESOLUTION, shifted).digest() == moved.digest()


@pytest.mark.parametrize("theta", [0.0, 0.4, 1.3, -2.2])
def test_a_bent_room_stays_closed_and_its_walls_thin(theta: float) -> None:
    before, _ = room().occupancy()
    after, _ = render(room(), (1.0, 2.0, theta), RESOLUTION, bend()).occupancy()
    rooms, labels = cv2.connectedComponents((after == 0).astype(np.uint8), connectivity=4)
    assert np.bincount(labels[after == 0]).max() == (after == 0).sum(), f"free space in {rooms - 1} pieces"
    assert abs(int((after == 0).sum()) - int((before == 0).sum())) < 0.02 * (before == 0).sum()
    assert (after == 100).sum() <= 1.45 * (before == 100).sum()


def test_rendering_moves_walls_to_where_the_field_takes_them() -> None:
    counts = np.zeros((2, 60, 60), np.uint16)
    counts[1] = 5
    counts[0, 30, 20] = 5
    grid = Grid.from_dense(counts, (10, 40), RESOLUTION)
    place = (np.array([[30.5, 70.5]])) * RESOLUTION
    raster, origin = render(grid, (0, 0, 0), RESOLUTION, bend()).occupancy()
    ((row, column),) = np.argwhere(raster == 100)
    found = (np.array([column, row]) + origin + 0.5) * RESOLUTION
    assert np.abs(found - (place + shifts(bend(), place))).max() <= RESOLUTION / 2 + 1e-6


def test_whole_number_shifts_are_those_of_the_field() -> None:
    inner = lattice(bend(), RESOLUTION)
    for x, y in np.random.default_rng(1).uniform((-8, -4), (14, 14), (200, 2)):
        at = [round(v / RESOLUTION * 2**36) for v in (x, y)]
        got = np.array(shift_at(*at, *inner)) * RESOLUTION / 2**36
        assert np.abs(got - shifts(bend(), [[x, y]])[0]).max() < 1e-4


def test_a_trajectory_turns_as_the_field_does() -> None:
    poses = np.array([[1.0, 2.0, 0.3], [6.0, 3.0, -1.0]])
    straight = straightened(bend(), poses)
    assert np.allclose(straight[:, :2] - poses[:, :2], shifts(bend(), poses[:, :2]))
    slope = (shifts(bend(), poses[:, :2] + [0.5, 0]) - shifts(bend(), poses[:, :2] - [0.5, 0]))[:, 1]
    assert np.allclose(straight[:, 2] - poses[:, 2], slope / 2)  # the field shears: half of it is turning
    assert np.array_equal(straightened(None, poses), poses)


@pytest.mark.parametrize(
    "broken", [{"columns": 1}, {"shifts_um": (1, 2, 3, 4)}, {"columns": 4}, {"shifts_um": (10**8,) * 126}]
)
def test_what_is_no_lattice_is_refused(broken: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Warp.model_validate(bend().model_dump() | broken)
