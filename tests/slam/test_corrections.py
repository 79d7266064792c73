"""What SLAM moves in a map that was shown is counted, and by how much it moved."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import driven

from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.graph.graph_slam import GraphSlam

WALL = np.array([[2.0, -1.0], [2.0, 0.0], [2.0, 1.0]], np.float32)
HERE = np.zeros(3)


def test_a_move_that_can_be_seen_is_a_correction_as_large_as_the_scan_that_moved_farthest() -> None:
    corrections = Corrections(resolution=0.05)
    corrections.moves(WALL, HERE, np.array([0.03, 0.0, 0.0]))
    corrections.moves(WALL, HERE, np.array([0.0, 0.2, 0.0]))
    corrections.shown()
    assert (corrections.times, round(corrections.metres, 6)) == (1, 0.2)


def test_a_turn_counts_by_how_far_it_moves_the_walls_that_were_seen() -> None:
    corrections = Corrections(resolution=0.05)
    corrections.moves(WALL, HERE, np.array([0.0, 0.0, 0.05]))
    corrections.shown()
    assert corrections.metres == pytest.approx(0.05 * np.hypot(2, 1), rel=0.01)


def test_moves_too_small_to_see_are_a_correction_once_they_add_up_to_half_a_cell() -> None:
    corrections = Corrections(resolution=0.05)
    for _ in range(3):
        corrections.moves(WALL, HERE, np.array([0.007, 0.0, 0.0]))
        corrections.shown()
    assert corrections.times == 0
    corrections.moves(WALL, HERE, np.array([0.007, 0.0, 0.0]))
    corrections.shown()
    assert (corrections.times, round(corrections.metres, 6)) == (1, 0.028)


def test_a_map_that_only_grows_is_not_corrected() -> None:
    kernel = GraphSlam.create({}, 1)
    for frame in driven()[:40]:
        kernel.process(frame)
        kernel.map()
    assert kernel.corrections.times == 0


def test_a_bent_trajectory_that_is_straightened_corrects_the_map() -> None:
    kernel = GraphSlam.create({}, 1)
    for frame in driven()[:200]:
        kernel.process(frame)
    kernel.map()
    kernel.graph.poses[:] = kernel.graph.poses + np.linspace(0.0, 0.3, len(kernel.graph.poses))[:, None] * [1, 0, 0]
    kernel.map()
    assert kernel.corrections.times == 1
    assert kernel.corrections.metres == pytest.approx(0.3, abs=0.02)
