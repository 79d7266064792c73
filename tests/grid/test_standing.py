"""A parked robot leaves no wall in the common map."""

import numpy as np
from numpy.typing import NDArray

from common.grid import Grid
from common.grid.compose import add, cap_votes
from common.grid.render import render
from common.grid.standing import CERTAIN, MarkedMap, certain, stands

CELL_M = 0.05


def way(*legs: tuple[float, float, float]) -> NDArray[np.float64]:
    """Trajectory (n, 4) at 10 Hz over legs of (seconds, m to go along x, m to go along y)."""
    rows, at, now = [], np.zeros(2), 0.0
    for seconds, x, y in legs:
        steps = round(seconds * 10)
        rows += [[now + 0.1 * k, *(at + np.array([x, y]) * k / steps), 0.0] for k in range(steps)]
        at, now = at + np.array([x, y]), now + seconds
    return np.array(rows)


def room(ghost: bool = False) -> Grid:
    """A square room of 4 m about the origin, walls along its border; `ghost`: another robot seen at the origin."""
    counts = np.zeros((2, 80, 80), np.uint16)
    counts[1] = 10
    counts[0, [0, -1], :] = counts[0, :, [0, -1]] = 10
    if ghost:
        counts[0, 38:42, 38:42], counts[1, 38:42, 38:42] = 250, 250
    return Grid.from_dense(counts, (-40, -40), CELL_M)


def at(grid: Grid, x: float, y: float) -> tuple[int, int]:
    """Hits and visits of the cell that holds this point."""
    dense, (x0, y0) = grid.dense()
    hits, visits = dense[:, int(np.floor(y / CELL_M)) - y0, int(np.floor(x / CELL_M)) - x0]
    return int(hits), int(visits)


def shown(grid: Grid, trajectory: NDArray[np.float64]) -> Grid:
    map_ = MarkedMap(CELL_M, 0)
    map_.follow(grid, stands(trajectory))
    return map_.grid


def test_a_stand_is_where_the_robot_stays_two_seconds() -> None:
    trajectory = way((3, 0, 0), (4, 2, 0), (1, 0, 0), (4, 0, 2), (2.5, 0.05, 0))
    assert np.allclose(stands(trajectory), [[0, 0], [2, 2]], atol=0.06)
    assert stands(np.empty((0, 4))).shape == (0, 2)


def test_a_parked_robot_is_no_wall_in_the_sum_however_long_others_have_watched_it() -> None:
    mine = shown(room(), way((3, 0, 0)))
    theirs = shown(room(ghost=True), way((4, 1.5, 1.5)))
    before = add([cap_votes(room(), 255), cap_votes(room(ghost=True), 255)])
    after = add([cap_votes(mine, 255), cap_votes(theirs, 255)])
    assert at(before, 0.0, 0.0)[0] > 200
    assert at(after, 0.0, 0.0) == (0, CERTAIN)
    assert at(after, 1.98, 0.0) == (20, 20)  # walls stay


def test_marks_survive_rendering_and_any_grouping_of_adding() -> None:
    pose = (0.31, -0.12, 0.7)
    parts = [shown(room(), way((3, 0, 0))), room(ghost=True), shown(room(), way((2, 1.5, 0), (3, 0, 0)))]
    a, b, c = (cap_votes(render(part, pose, CELL_M), 255) for part in parts)
    assert add([add([a, b]), c]).digest() == add([a, add([c, b])]).digest() == add([c, b, a]).digest()
    assert at(add([a, b, c]), *pose[:2]) == (0, CERTAIN)


def test_a_wall_beside_the_robot_is_not_marked_free() -> None:
    grid = shown(room(), way((5, 1.8, 0), (3, 0, 0)))
    assert at(grid, 1.98, 0.0) == (10, 10)
    assert at(grid, 1.9, 0.0) == (0, CERTAIN)


def test_unseen_cells_are_only_marked_where_the_body_stood() -> None:
    dense, origin = room().dense()
    dense[:, 64:, 64:] = 0
    dense[1, 66, 66] = 10
    grid = shown(Grid.from_dense(dense, origin, CELL_M), way((3, 0, 0)))
    assert at(grid, 0.3, 0.3) == (0, 0)
    assert at(grid, 0.05, 0.05) == (0, CERTAIN)
    assert at(grid, -0.1, 0.0) == (0, CERTAIN)


def test_a_stand_that_the_kernel_moves_is_marked_where_it_is_now_and_only_there() -> None:
    map_, grid = MarkedMap(CELL_M, 0), room()
    map_.follow(grid, stands(way((3, 0, 0))))
    version = map_.grid.version
    map_.follow(grid, stands(way((3, 0, 0))))
    assert map_.grid.version == version  # nothing new, nothing to send
    map_.follow(grid, stands(way((3, 0, 0))) + np.array([1.2, 0]))
    assert at(map_.grid, 0.0, 0.0) == (0, 10)
    assert at(map_.grid, 1.2, 0.0) == (0, CERTAIN)
    assert not certain(grid.dense()[0]).any()  # the kernel's own map is left alone
