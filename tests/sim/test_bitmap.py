"""Worlds from maps and pictures."""

import os
from pathlib import Path

import numpy as np
import pytest

from common.errors import BadFile
from common.formats.map_image import write_pgm
from common.formats.map_server import write_map
from common.sim.bitmap import boundary, load_bitmap, load_map
from common.sim.draw import draw_scene
from common.sim.motion import Pace
from common.sim.scene import load_scene

DATA = os.environ.get("RECSLAM_DATA")
with_data = pytest.mark.skipif(DATA is None, reason="RECSLAM_DATA is not set: no real maps to read")


def house() -> np.ndarray:
    """Occupancy (60, 80): a walled room with a pillar, unknown outside."""
    cells = np.full((60, 80), -1, np.int8)
    cells[5:55, 5:75] = 100
    cells[7:53, 7:73] = 0
    cells[30:34, 20:24] = 100
    cells[40, 60] = 100
    return cells


def test_borders_are_merged_into_the_longest_segments() -> None:
    walls = np.zeros((4, 6), bool)
    walls[1:3, 1:5] = True
    walls[1, 2] = False
    lying = {(1, 1, 2, 1), (3, 1, 5, 1), (1, 3, 5, 3), (2, 2, 3, 2)}
    standing = {(1, 1, 1, 3), (5, 1, 5, 3), (2, 1, 2, 2), (3, 1, 3, 2)}
    assert set(map(tuple, boundary(walls))) == lying | standing


def test_touching_walls_of_opposite_sides_stay_two_segments() -> None:
    walls = np.array([[True, False], [False, True]])
    assert sum(np.abs(s[2] - s[0]) + np.abs(s[3] - s[1]) for s in boundary(walls)) == 8
    assert (1, 0, 1, 1) in set(map(tuple, boundary(walls)))


def test_a_saved_map_becomes_a_world_in_its_own_frame(tmp_path: Path) -> None:
    path = write_map(tmp_path / "house", house(), 0.1, (-2.0, 1.0, 0.0))
    world, start = load_map(path)
    assert world.bounds == pytest.approx((-1.5, 1.5, 5.5, 6.5))
    assert len(world.segments) == 4 + 4 + 4  # outer, inner, pillar; the single cell is noise
    assert -1.3 < start[0] < 5.3
    assert 1.7 < start[1] < 6.3
    assert world.clearance([start])[0] > 0.3
    track = load_scene(str(path)).track("ann", 1, Pace(), duration_s=60)
    assert world.clearance(track.at(np.arange(0, 60, 0.2))[:, :2]).min() > 0.2


def test_a_turned_map_gives_a_turned_world(tmp_path: Path) -> None:
    world, _ = load_map(write_map(tmp_path / "house", house(), 0.1, (0.0, 0.0, np.pi / 2)))
    assert world.bounds == pytest.approx((-5.5, 0.5, -0.5, 7.5))


def test_a_renamed_map_finds_its_image(tmp_path: Path) -> None:
    write_map(tmp_path / "old", house(), 0.1)
    (tmp_path / "old.pgm").rename(tmp_path / "new.pgm")
    (tmp_path / "old.yaml").rename(tmp_path / "new.yaml")
    assert len(load_map(tmp_path / "new.yaml")[0].segments) == 12


def test_a_picture_takes_its_size_in_metres(tmp_path: Path) -> None:
    pixels = np.full((50, 100), 255, np.uint8)
    pixels[20:30, 40:60] = 0
    write_pgm(tmp_path / "block.pgm", pixels)
    world, _ = load_bitmap(tmp_path / "block.pgm", 20.0, border=True)
    assert world.bounds == pytest.approx((0.0, 0.0, 20.0, 10.0))
    inner = world.segments[(np.abs(world.segments - [10, 5, 10, 5]) < 3).all(axis=1)].reshape(-1, 2)
    np.testing.assert_allclose([inner.min(axis=0), inner.max(axis=0)], [[8, 4], [12, 6]])


def test_pictures_without_walls_or_without_room_are_refused(tmp_path: Path) -> None:
    write_pgm(tmp_path / "void.pgm", np.full((20, 20), 255, np.uint8))
    with pytest.raises(BadFile, match=r"void\.pgm: holds no wall"):
        load_bitmap(tmp_path / "void.pgm", 5.0)
    with pytest.raises(BadFile, match=r"full.yaml: leaves no free space"):
        load_map(write_map(tmp_path / "full", np.full((20, 20), 100, np.int8), 0.1))


@with_data
@pytest.mark.parametrize("name", ["small_house", "tb3_world_map", "warehouse"])
def test_robots_walk_through_real_maps(name: str) -> None:
    scene = load_scene(str(Path(DATA or "") / "worlds" / f"{name}.yaml"))
    track = scene.track("ann", 2, Pace(), duration_s=60)
    assert scene.world.clearance(track.at(np.arange(0, 60, 0.5))[:, :2]).min() > 0.2


@with_data
@pytest.mark.parametrize(("name", "width"), [("cave", 16.0), ("simple_rooms", 15.0), ("hospital_section", 54.0)])
def test_pictures_of_other_simulators_become_worlds(name: str, width: float) -> None:
    world, start = load_bitmap(Path(DATA or "") / "worlds" / f"{name}.png", width, border=True)
    assert world.bounds[2] - world.bounds[0] == pytest.approx(width, abs=0.01)
    assert world.clearance([start])[0] > 0.3


def test_a_scene_can_be_drawn() -> None:
    picture = draw_scene(load_scene("apartment"), 300, {"seen": np.array([[1.0, 1.0]])})
    assert picture.shape[0] > picture.shape[1]
    assert (picture == (0, 0, 255)).all(axis=2).any()
