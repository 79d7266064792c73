"""What a loop of the `graph` kernel may say: nothing along a corridor, and something of old keyframes, too."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import driven, robot, run
from numpy.typing import NDArray

from common.geometry import between, compose
from common.geometry.pose_graph import PoseGraph
from services.edge_worker.slam.graph.holders import Query
from services.edge_worker.slam.graph.keyframe import Keyframe, normals
from services.edge_worker.slam.graph.loop_closer import LoopCloser
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.submap import Submap, Target

WIDTH_M = 2.0


def corridor(end_m: float | None, seed: int) -> Keyframe:
    """A look along a corridor from its middle, to a wall across its end if there is one."""
    angles = np.radians(np.arange(-90.0, 90.5, 0.5))
    with np.errstate(divide="ignore"):
        ranges = np.minimum(WIDTH_M / 2 / np.abs(np.sin(angles)), 12.0)
        if end_m is not None:
            ranges = np.minimum(ranges, end_m / np.maximum(np.cos(angles), 1e-9))
    beams = np.flatnonzero(ranges < 12.0).astype(np.int32)
    ranges = ranges[beams] + np.random.default_rng(seed).normal(0.0, 0.01, len(beams))
    points = (ranges[:, None] * np.stack([np.cos(angles[beams]), np.sin(angles[beams])], 1)).astype(np.float32)
    facing = normals(points, beams, np.zeros(2))
    return Keyframe(points, facing, beams, np.empty((0, 2), np.float32), np.zeros(2), views=())


def looked(end_m: float | None, slid: NDArray[np.float64], guess: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Pose (3,) and information (3, 3) of a loop that the search found at `slid`, where `guess` was reckoned."""
    ends = [None if end_m is None else end_m - 0.3 * k for k in range(8)]
    submap = Submap(0, tuple(range(8)), np.array([[0.3 * k, 0.0, 0.0] for k in range(8)]))
    keyframes = [corridor(end, seed) for seed, end in enumerate(ends)]
    keyframes.append(corridor(None if end_m is None else end_m - 1.0, 99))
    query = Query.of(range(8, 9), np.zeros((1, 3)), keyframes, 0.1, 400)
    loop = LoopCloser(GraphSettings())._judged(Target(submap, keyframes), submap, query, guess, slid)
    assert loop is not None
    pose = between(between(submap.poses[loop.anchor], np.zeros(3)), loop.measured)
    return pose, loop.information


def test_a_loop_in_a_corridor_corrects_across_it_and_keeps_to_dead_reckoning_along_it() -> None:
    pose, information = looked(None, np.array([2.5, 0.02, 0.005]), np.array([1.0, 0.3, 0.05]))
    assert np.all(np.abs(pose - (1.0, 0.0, 0.0)) < (0.15, 0.02, 0.01))
    assert np.linalg.inv(information)[0, 0] > 20.0**2
    assert information[1, 1] > 0.02**-2


@pytest.mark.parametrize("seed", [0, 400, 500])
def test_a_search_that_slid_far_along_a_corridor_leaves_the_robot_where_its_walls_are(seed: int) -> None:
    """Rough walls tell within a degree or so which way is along: 6 m along are 2 cm across."""
    keyframes = [corridor(None, seed + k) for k in range(24)] + [corridor(None, seed + 99)]
    submap = Submap(0, tuple(range(24)), np.array([[0.3 * k, 0.0, 0.0] for k in range(24)]))
    query = Query.of(range(24, 25), np.zeros((1, 3)), keyframes, 0.1, 400)
    guess, slid = np.array([1.0, 0.3, 0.01]), np.array([7.0, 0.02, 0.005])
    loop = LoopCloser(GraphSettings(), travelled=116.0)._judged(Target(submap, keyframes), submap, query, guess, slid)
    assert loop is not None
    pose = compose(submap.poses[loop.anchor], loop.measured)
    assert np.all(np.abs(pose - (1.0, 0.0, 0.0)) < (0.05, 0.007, 0.002))


def test_a_loop_at_the_end_of_a_corridor_corrects_along_it() -> None:
    pose, information = looked(6.0, np.array([1.05, 0.02, 0.005]), np.array([1.5, 0.3, 0.05]))
    assert np.abs(pose - (1.0, 0.0, 0.0)).max() < 0.02
    assert np.linalg.inv(information)[0, 0] < 0.05**2


def test_a_loop_is_told_of_the_keyframe_that_saw_the_end_of_the_corridor_not_of_one_that_slipped_on_after_it() -> None:
    """The query's last keyframe, which sees no end, is 0.3 m further on by odometry than it is."""
    members, slip = [0.3 * k for k in range(8)], 0.3
    keyframes = [corridor(6.0 - at, seed) for seed, at in enumerate(members)]
    keyframes += [corridor(6.0 - 0.6, 98), corridor(None, 99)]
    submap = Submap(0, tuple(range(8)), np.array([[at, 0.0, 0.0] for at in members]))
    query = Query.of(range(8, 10), np.array([[-0.6 - slip, 0.0, 0.0], [0.0, 0.0, 0.0]]), keyframes, 0.1, 400)
    here = np.array([1.2 + slip, 0.0, 0.0])
    loop = LoopCloser(GraphSettings())._judged(Target(submap, keyframes), submap, query, here, here)
    assert loop is not None
    assert (loop.keyframe, loop.latest) == (8, 9)
    assert np.abs(compose(submap.poses[loop.anchor], loop.measured) - (0.6, 0.0, 0.0)).max() < 0.02
    assert loop.firm


def test_a_loop_is_told_of_the_member_that_saw_the_end_of_the_corridor_not_of_a_nearer_one_that_slipped() -> None:
    """The later half of the submap sees no end, and is 0.3 m further on by odometry than it is."""
    members, slip = np.array([0.3 * k for k in range(8)]), 0.3
    keyframes = [corridor(6.0 - at if k < 4 else None, k) for k, at in enumerate(members)]
    keyframes.append(corridor(6.0 - 1.8, 99))
    told = np.where(members < 1.0, members, members + slip)
    submap = Submap(0, tuple(range(8)), np.stack([told, np.zeros(8), np.zeros(8)], axis=1))
    query = Query.of(range(8, 9), np.zeros((1, 3)), keyframes, 0.1, 400)
    here = np.array([1.8, 0.0, 0.0])
    loop = LoopCloser(GraphSettings())._judged(Target(submap, keyframes), submap, query, here, here)
    assert loop is not None
    assert np.abs(loop.measured - (1.8 - members[loop.anchor], 0.0, 0.0)).max() < 0.02
    assert loop.firm


def test_a_loop_is_told_of_the_nearest_member_where_walls_hold_all_alike() -> None:
    keyframes = [corridor(6.0 - 0.3 * k, k) for k in range(8)] + [corridor(6.0 - 1.2, 99)]
    submap = Submap(0, tuple(range(8)), np.array([[0.3 * k, 0.0, 0.0] for k in range(8)]))
    query = Query.of(range(8, 9), np.zeros((1, 3)), keyframes, 0.1, 400)
    here = np.array([1.2, 0.0, 0.0])
    loop = LoopCloser(GraphSettings())._judged(Target(submap, keyframes), submap, query, here, here)
    assert loop is not None
    assert loop.anchor == 4


def test_keyframes_of_long_ago_are_seen_in_the_latest_submap_and_lie_where_they_did() -> None:
    kernel = run(driven(duration_s=80.0), local_keyframes=20)
    pairs, loops = kernel.graph.pairs, kernel.graph.loops == 1
    back = loops & (pairs[:, 0] > pairs[:, 1])
    assert back.sum() > 5
    rows = kernel.trajectory()
    keyframes = kernel.track.state()[1]
    first = np.array([np.flatnonzero(keyframes == k)[0] for k in range(len(kernel.keyframes))])
    truth = robot(duration_s=80.0).poses(rows[first, 0])
    off = between(between(truth[pairs[back, 0]], truth[pairs[back, 1]]), kernel.graph.measured[back])
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.06


def test_there_is_nothing_to_look_back_at_before_the_first_submap() -> None:
    assert LoopCloser(GraphSettings()).look_back(PoseGraph(), [corridor(6.0, 0)]) == []


def test_a_loop_that_each_metre_between_its_ends_contradicts_leaves_no_trace() -> None:
    """Rooms that look alike are not one room; a loop that is right stays."""
    kernel = run(driven(scene="two_rooms")[:150])
    kernel.finish()
    before, edges = kernel.graph.poses.copy(), len(kernel.graph.pairs)
    sure, last = np.diag([1e4, 1e4, 1e5]), len(before) - 1
    wrong = compose(between(before[2], before[last]), (3.0, 0.0, 0.5))
    kernel.graph.add_edge(2, last, wrong, sure, loop=True)
    kernel.graph.add_edge(3, last - 1, between(before[3], before[last - 1]), sure, loop=True)
    kernel.pending = 2
    kernel.finish()
    assert kernel.graph.pairs[edges:].tolist() == [[3, last - 1]]
    assert np.abs(kernel.graph.poses - before)[:, :2].max() < 0.01
