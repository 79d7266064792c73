"""Promises of the drawing of a graph's map: whole maps only, the same however it was drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from graph_cases import driven, run

from services.edge_worker.slam.graph.graph_slam import GraphSlam
from services.edge_worker.slam.graph.rendering import Rendering

BEND = np.array([0.5, 0.3, 0.02])
"""what a correction moves the last keyframe by, and the others by as much as they are late"""


@pytest.fixture(scope="module")
def kernel() -> GraphSlam:
    return run(driven())


def bent(kernel: GraphSlam, share: float = 1.0) -> np.ndarray:
    """The keyframes' poses, the last `share` of them moved."""
    late = np.clip(1 - (1 - np.linspace(0, 1, len(kernel.keyframes))) / share, 0.0, 1.0)
    return kernel.graph.poses + late[:, None] * BEND


def drawn(kernel: GraphSlam, poses: np.ndarray) -> str:
    return Rendering(0.05).update(kernel.keyframes, poses).digest()


@pytest.mark.parametrize("share", [0.2, 1.0], ids=["a few moved", "all moved"])
def test_a_map_shows_nothing_of_a_correction_until_it_shows_all_of_it(kernel: GraphSlam, share: float) -> None:
    rendering, poses = Rendering(0.05), bent(kernel, share)
    grid = rendering.update(kernel.keyframes, kernel.graph.poses)
    before, slices = (grid.version, grid.digest()), 0
    while not rendering.prepare(kernel.keyframes, poses, 0.0):
        slices += 1
        assert (grid.version, grid.digest()) == before
    assert slices >= share * len(kernel.keyframes) / 2
    assert rendering.update(kernel.keyframes, poses).digest() == drawn(kernel, poses)


def test_a_correction_amid_the_drawing_of_another_one_gives_the_same_map_too(kernel: GraphSlam) -> None:
    rendering = Rendering(0.05)
    rendering.update(kernel.keyframes, kernel.graph.poses)
    for share in (1.0, 0.3, 0.9, 0.5):
        for _ in range(len(kernel.keyframes) // 3):
            rendering.prepare(kernel.keyframes, bent(kernel, share), 0.0)
    poses = bent(kernel, 0.6)
    assert rendering.update(kernel.keyframes, poses).digest() == drawn(kernel, poses)


def test_keyframes_that_were_dropped_amid_a_drawing_leave_nothing_behind(kernel: GraphSlam) -> None:
    rendering, poses = Rendering(0.05), bent(kernel, 0.3)
    rendering.update(kernel.keyframes, kernel.graph.poses)
    for _ in range(5):
        rendering.prepare(kernel.keyframes, poses, 0.0)
    gone = np.arange(1, len(kernel.keyframes), 7)
    rendering.forget(kernel.keyframes, gone)
    kept = [frame for k, frame in enumerate(kernel.keyframes) if k not in set(gone.tolist())]
    poses = np.delete(poses, gone, axis=0)
    assert rendering.update(kept, poses).digest() == Rendering(0.05).update(kept, poses).digest()


def test_what_was_prepared_is_not_drawn_again(kernel: GraphSlam, monkeypatch: pytest.MonkeyPatch) -> None:
    rendering = Rendering(0.05)
    assert rendering.prepare(kernel.keyframes, kernel.graph.poses, math.inf)
    monkeypatch.setattr(rendering, "_draw", pytest.fail)
    assert rendering.update(kernel.keyframes, kernel.graph.poses).digest() == drawn(kernel, kernel.graph.poses)


def test_a_correction_in_two_slices_is_told_once_and_when_it_shows(kernel: GraphSlam) -> None:
    rendering, poses = Rendering(0.05), kernel.graph.poses + np.array([0.3, 0.0, 0.0])
    rendering.update(kernel.keyframes, kernel.graph.poses)
    rendering.prepare(kernel.keyframes, poses, 0.0)
    assert rendering.corrections.times == 0
    rendering.update(kernel.keyframes, poses)
    assert rendering.corrections.times == 1
    assert rendering.corrections.metres == pytest.approx(0.3, abs=0.02)
