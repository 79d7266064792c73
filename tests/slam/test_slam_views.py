"""Promises of the scans between keyframes that are drawn as well."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import changed, driven

from common.geometry import compose
from services.edge_worker.slam.graph.graph_slam import VIEWS, GraphSlam


@pytest.fixture(scope="module")
def kernel() -> GraphSlam:
    """Stopped where scans wait for their keyframe."""
    kernel = GraphSlam.create({}, 1)
    for frame in driven()[:200]:
        kernel.process(frame)
        if frame.seq > 100 and kernel.views:
            break
    assert kernel.views
    return kernel


def test_each_view_is_drawn_where_its_scan_was_taken(kernel: GraphSlam) -> None:
    """That is at a pose of the trajectory, the keyframe's own last."""
    rows = kernel.trajectory()[:, 1:]
    for keyframe, pose in zip(kernel.keyframes, kernel.graph.poses, strict=True):
        for view in keyframe.views:
            place = compose(pose, view.pose)
            assert np.abs(rows - place).max(axis=1).min() < 0.02
        assert not keyframe.views[-1].pose.any()


def test_a_keyframe_has_few_views_and_a_robot_that_stands_adds_none(kernel: GraphSlam) -> None:
    counts = [len(keyframe.views) for keyframe in kernel.keyframes]
    assert max(counts) == VIEWS + 1
    parked = GraphSlam.create({}, 1)
    still = driven()[0]
    for seq in range(30):
        parked.process(changed(still, seq=seq, stamp=still.stamp + 0.2 * seq, odometry=None))
    assert len(parked.keyframes) == 1
    assert not parked.views


def test_views_outlive_a_snapshot_bit_for_bit(kernel: GraphSlam) -> None:
    other = GraphSlam.create({}, 1)
    other.restore(kernel.snapshot())
    groups = [(frame.views, twin.views) for frame, twin in zip(kernel.keyframes, other.keyframes, strict=True)]
    for views, twins in [*groups, (kernel.views, other.views)]:
        assert len(views) == len(twins)
        for view, twin in zip(views, twins, strict=True):
            for name in ("pose", "ends", "joined", "silent", "laser"):
                assert np.array_equal(getattr(view, name), getattr(twin, name))
    assert other.map().digest() == kernel.map().digest()
