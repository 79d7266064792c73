"""Truth holds what could be seen, all of it, and nothing behind a wall."""

import numpy as np

from common.sim.robot import SimulatedRobot
from common.sim.scene import Scene
from common.sim.truth import face_samples, visible_area, visible_walls
from common.sim.world import Plan


def two_cells() -> Scene:
    """Two rooms of 4 x 3 m side by side, no door; a box in the west one."""
    plan = Plan()
    plan.room(0, 0, 8, 3, thickness=0.2)
    plan.wall((4, 0), (4, 3), thickness=0.2)
    plan.box(1.0, 2.0, 0.6, 0.9)  # its north face is hidden in the wall
    return Scene("cells", plan.world(), (3, 1), {"west": np.array([[0.5, 0.6], [3.4, 0.7], [3.4, 2.5]])})


def test_visible_faces_are_the_inner_ones_of_the_room_driven() -> None:
    scene = two_cells()
    points = visible_walls(scene, [SimulatedRobot(scene, "west", 0)], 0.05)
    on_west_room = (np.abs(points[:, 0] - 0.1) < 1e-6) | (np.abs(points[:, 0] - 3.9) < 1e-6)
    on_west_room |= (np.abs(points[:, 1] - 0.1) < 1e-6) | (np.abs(points[:, 1] - 2.9) < 1e-6)
    on_box = (points[:, 0] > 1 - 1e-6) & (points[:, 0] < 1.6 + 1e-6) & (points[:, 1] > 2 - 1e-6)
    assert (on_west_room | on_box).all()
    assert points[:, 0].max() < 4.0
    expected = 2 * 3.8 + 2 * 2.8 + 2 * 0.9 + 0.6 - 0.6  # the room, three faces of the box, less what it covers
    assert len(points) * 0.025 == np.float64(expected) or abs(len(points) * 0.025 - expected) < 0.5


def test_visible_points_are_half_a_cell_apart_or_less() -> None:
    scene = two_cells()
    samples = face_samples(scene.world.segments, 0.025)
    steps = np.hypot(*np.diff(samples, axis=0).T)
    assert (steps[steps < 0.03] <= 0.025 + 1e-9).all()
    points = visible_walls(scene, [SimulatedRobot(scene, "west", 0)], 0.05)
    south = np.sort(points[np.abs(points[:, 1] - 0.1) < 1e-6, 0])
    assert np.diff(south).max() <= 0.0251


def test_a_laser_of_short_reach_or_narrow_view_sees_less() -> None:
    scene = two_cells()
    far, near, ahead = (
        len(visible_walls(scene, [SimulatedRobot(scene, "west", 0, lidar=lidar, duration_s=0.5)], 0.05))
        for lidar in ("rplidar_a1", "lds01", "sick")
    )
    assert near < far
    assert ahead < far


def test_the_area_seen_is_the_room_without_its_box() -> None:
    scene = two_cells()
    cells = visible_area(scene, [SimulatedRobot(scene, "west", 0)], 0.1)
    assert abs(len(cells) * 0.01 - (3.8 * 2.8 - 0.6 * 0.9)) < 0.15
    np.testing.assert_allclose(cells / 0.1 - 0.5, np.round(cells / 0.1 - 0.5), atol=1e-6)


def test_more_robots_never_see_less() -> None:
    scene = two_cells()
    one, other = SimulatedRobot(scene, "west", 0, duration_s=1.0), SimulatedRobot(scene, "ann", 3, duration_s=20.0)
    both = set(map(tuple, visible_walls(scene, [one, other], 0.1)))
    assert set(map(tuple, visible_walls(scene, [one], 0.1))) <= both
    assert set(map(tuple, visible_walls(scene, [other], 0.1))) <= both
