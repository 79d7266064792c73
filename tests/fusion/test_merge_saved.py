"""Saved maps, of whatever origin and resolution, become one map, or are said to share nothing."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from drawn_worlds import RESOLUTION, apartment

from common.errors import BadFile, UsageError
from common.formats.map_server import read_map, write_map
from common.geometry import between, compose
from common.grid import Grid
from common.grid.render import render
from services.command.merge import Merged, as_data, as_lines, merge, overlap_lines, write

OFFSETS = {"1n": (680, 2), "1s": (-31, 3)}
"""rows and columns from the top of map 1, as the data's description tells"""


def saved(path: Path, seed: int, window_m: tuple[float, float], frame: np.ndarray, resolution: float = 0.05) -> Path:
    """The map of a part of an apartment in a frame of its own, with an origin that is turned."""
    counts = apartment(seed)
    x0, x1 = (round(x / RESOLUTION) + 10 for x in window_m)
    counts[:, :, :x0] = 0
    counts[:, :, x1:] = 0
    origin = np.array([-7.3, 2.11, 0.4])
    image = compose(frame, origin)
    grid = render(Grid.from_dense(counts, (-10, -10), RESOLUTION), between(image, np.zeros(3)), resolution)
    cells, (x, y) = grid.occupancy()
    corner = compose(origin, (x * resolution, y * resolution, 0))
    return write_map(path, cells, resolution, tuple(float(v) for v in corner))


FRAMES = {"east": np.array([4.0, 1.0, 2.0]), "west": np.array([-2.0, 3.0, -0.7])}


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> Merged:
    folder = tmp_path_factory.mktemp("maps")
    west = saved(folder / "west", 2, (0, 11), FRAMES["west"])
    east = saved(folder / "east", 2, (5, 16), FRAMES["east"], resolution=0.1)
    return merge([west, east])


def test_maps_of_turned_origins_and_mixed_resolutions_become_one(pair: Merged, tmp_path: Path) -> None:
    assert [each.robots for each in pair.components] == [("east", "west")]
    assert pair.poses["east"] == pytest.approx(np.zeros(3))
    assert pair.poses["west"] == pytest.approx(between(FRAMES["east"], FRAMES["west"]), abs=0.06)
    files = write(pair, tmp_path / "out")
    assert [path.name for path in files] == ["merged.yaml", "merge.json"]
    found = read_map(files[0])
    assert found.resolution == 0.05
    assert (found.occupancy >= 0).sum() * 0.05**2 == pytest.approx(16 * 12, rel=0.05)
    assert as_lines(pair)[-1] == "one map of east, west"


def test_the_overlap_matrix_is_the_papers(pair: Merged) -> None:
    expected = 6 / (11 + 11)
    assert pair.overlap() == pytest.approx(np.array([[0, expected], [expected, 0]]), abs=0.02)
    assert overlap_lines(pair)[1].split()[0] == "east"


def test_maps_that_share_nothing_are_laid_out_apart_and_said_to_be(tmp_path: Path) -> None:
    ours, theirs = tmp_path / "ours" / "map", tmp_path / "theirs" / "map"
    found = merge([saved(ours, 2, (0, 16), FRAMES["west"]), saved(theirs, 77, (0, 16), FRAMES["east"])])
    assert [each.robots for each in found.components] == [("ours-map",), ("theirs-map",)]
    assert "laid out apart: ours-map | theirs-map" in as_lines(found)[-1]
    alone = sum(each.grid.known_m2() for each in found.pieces.values())
    assert found.grid(sorted(found.pieces)).known_m2() == pytest.approx(alone, rel=0.02)
    assert not found.overlap().any()
    names = [path.name for path in write(found, tmp_path / "out")]
    assert names == ["merged.yaml", "component-ours-map.yaml", "component-theirs-map.yaml", "merge.json"]
    assert [part["maps"] for part in as_data(found)["components"]] == [["ours-map"], ["theirs-map"]]


def test_one_map_alone_is_no_merge(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="two maps"):
        merge([tmp_path / "alone.yaml"])


def test_a_file_that_is_no_map_is_named(tmp_path: Path) -> None:
    (tmp_path / "noise.yaml").write_text("hello: there\n")
    with pytest.raises(BadFile, match=r"noise\.yaml"):
        merge([tmp_path / "noise.yaml", tmp_path / "noise.yaml"])


def test_a_map_whose_resolution_is_not_in_metres_is_named(tmp_path: Path) -> None:
    cells = np.zeros((1000, 1000), np.int8)
    right, wrong = write_map(tmp_path / "right", cells, 0.05), write_map(tmp_path / "wrong", cells, 50.0)
    with pytest.raises(BadFile, match=r"wrong\.yaml: resolution 50 makes it 50000 x 50000 m.*in metres"):
        merge([right, wrong])


@pytest.mark.skipif("RECSLAM_DATA" not in os.environ, reason="RECSLAM_DATA names no folder of real data")
def test_parts_of_a_real_floor_plan_are_placed_to_a_cell() -> None:
    folder = Path(os.environ["RECSLAM_DATA"]) / "maps" / "utexas_gdc"
    found = merge([folder / f"{name}.yaml" for name in ("1", "1n", "1s")])
    assert len(found.components) == 1
    whole = found.pieces["1"].saved
    for name, (rows, columns) in OFFSETS.items():
        part = found.pieces[name].saved
        low = len(whole.occupancy) - rows - len(part.occupancy)
        place = between(whole.origin, found.image_pose(name))
        assert place == pytest.approx(np.array([columns * 0.05, low * 0.05, 0.0]), abs=0.05)
