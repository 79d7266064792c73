"""Two simulated robots, mapped by the graph kernel: one stands all the while in the way that the other drives past."""

import numpy as np
import pytest

from common.grid import Grid
from common.grid.compose import add, cap_votes
from common.grid.render import render
from common.grid.standing import MarkedMap, stands
from common.sim import SimulatedRobot, load_scene
from common.sim.scene import Scene
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack

CELL_M = 0.05


def walls_near(grid: Grid, x: float, y: float) -> int:
    """Occupied cells within 0.25 m of this point."""
    cells, (x0, y0) = grid.occupancy()
    rows, columns = np.mgrid[: cells.shape[0], : cells.shape[1]]
    away = np.hypot((columns + x0 + 0.5) * CELL_M - x, (rows + y0 + 0.5) * CELL_M - y)
    return int(np.count_nonzero(cells[away < 0.25] == 100))


@pytest.mark.parametrize("lidar", ["lds01", "rplidar_a1"])
def test_a_robot_that_stands_where_others_see_it_is_no_wall_in_the_common_map(lidar: str) -> None:
    apartment = load_scene("apartment")
    way = apartment.routes["r1"]
    x, y = way[2] + [0.6, 0.0]
    routes = {"driver": way, "parked": np.array([[x, y], [x + 0.02, y]])}
    scene = Scene("apartment", apartment.world, apartment.start, routes)
    plain, marked = [], []
    for name, peer in (("driver", "parked"), ("parked", "driver")):
        robot = SimulatedRobot(scene, name, 3, lidar=lidar, peers=(peer,), duration_s=40.0)
        kernel = create("graph", {}, 1)
        for seq, sweep in enumerate(robot.sweeps()):
            kernel.process(pack(sweep, name, "0" * 32, seq))
        kernel.finish()
        shown = MarkedMap(CELL_M, 0)
        shown.follow(kernel.map(), stands(kernel.trajectory()))
        for grids, grid in ((plain, kernel.map()), (marked, shown.grid)):
            grids.append(cap_votes(render(grid, robot.pose(0.0), CELL_M), 255))
    assert walls_near(add(plain), x, y) > 10
    assert walls_near(add(marked), x, y) == 0
