"""Pictures of maps: colours, orientation, and ways where the robots went."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from common.errors import UsageError
from common.formats.picture import COLOURS, draw_map, write_png


def test_free_is_white_walls_black_unknown_grey_and_y_points_up(tmp_path):
    write_png(tmp_path / "new" / "a.png", np.array([[0, 100], [-1, -1]], np.int8), 0.05)
    image = cv2.imread(str(tmp_path / "new" / "a.png"), cv2.IMREAD_GRAYSCALE)
    assert image.tolist() == [[160, 160], [255, 0]]


def test_a_way_is_drawn_where_the_robot_went():
    free = np.zeros((40, 60), np.int8)
    yaw = np.pi / 2
    # Along the map's own x axis at 1 m height, in a frame that sees the map turned by a right angle.
    way = np.array([[10 - 1.05, y, 0.0] for y in np.linspace(20.2, 22.0, 30)])
    image = draw_map(free, 0.05, (10.0, 20.0, yaw), {"": way})
    drawn = np.argwhere((image != 255).any(axis=-1))
    assert len(drawn) > 20
    assert abs(np.median(drawn[:, 0]) - (40 - 1.05 / 0.05)) <= 1
    assert abs(drawn[:, 1].min() - 4) <= 1


def test_robots_get_colours_by_name_and_gaps_stay_gaps():
    free = np.zeros((60, 200), np.int8)
    gap = np.array([[0, 0.5, 1, 0], [1, 1.0, 1, 0], [2, np.nan, 1, 0], [3, 8.0, 1, 0], [4, 8.5, 1, 0]])
    image = draw_map(
        free, 0.05, trajectories={"b": gap, "a": gap + np.array([0, 0, 1, 0]), "empty": np.zeros((0, 3))}, scale=2
    )
    assert (image[2 * (60 - 20) - 1, 2 * 80] == 255).all()
    for colour in COLOURS[:2]:
        assert (image == colour).all(axis=-1).any()


def test_what_is_no_way_is_refused_by_name():
    with pytest.raises(UsageError, match="r7"):
        draw_map(np.zeros((4, 4), np.int8), 0.05, trajectories={"r7": [[1, 2]]})
