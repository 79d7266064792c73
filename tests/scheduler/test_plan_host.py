"""The planning process, called as the scheduler calls it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.errors import BadMessage
from common.grid.grid import FREE
from common.grid.tiles import encode_occupancy
from common.wire import FixedPose, OverlapMatrix, Placed, Transforms, decode, encode
from services.scheduler.plan_host import PlanHost
from services.scheduler.regrouping import relabelled

EDGES = [{"name": name, "speed": 1.0, "bandwidth": 1e8, "cores": 2} for name in ("e1", "e2")]
POLICY = {
    "budget_s": 0.02,
    "kappa": 20,
    "tau": 5,
    "hysteresis": 0.1,
    "fusion": [0.03, 0.02, 2e-4],
    "horizon": 10.0,
    "noise": {},
}


def robot(name: str, at: tuple[float, float] | None, edge: str, reach: list[str] | None = None) -> dict[str, Any]:
    return {
        "name": name,
        "reach": reach,
        "start": (*at, 0.0) if at is not None else None,
        "range_max": 3.0,
        "frame_bytes": 1000.0,
        "bandwidth": [1e7, 1e7],
        "slam_s": 0.01,
        "pack_s": 0.001,
        "move_s": 0.1,
        "slam": edge,
        "fuse": edge,
    }


def two_rooms() -> list[dict[str, Any]]:
    """r1 and r3 start in one room, r2 and r4 in another; each edge has one of each."""
    return [
        robot("r1", (0, 0), "e1"),
        robot("r2", (50, 0), "e1"),
        robot("r3", (0.5, 0), "e2"),
        robot("r4", (50, 0.5), "e2"),
    ]


def test_robots_whose_maps_overlap_come_to_one_edge() -> None:
    made = PlanHost().plan(two_rooms(), EDGES, None, "paper", **POLICY)
    fuse = made["fuse"]
    assert fuse["r1"] == fuse["r3"] != fuse["r2"] == fuse["r4"]
    assert made["cut"] == pytest.approx(0.0)


def test_a_plan_that_is_no_better_keeps_everybody_where_they_are() -> None:
    robots = two_rooms()
    made = PlanHost().plan(robots, EDGES, None, "paper", **POLICY)
    for each in robots:
        each["fuse"] = made["fuse"][each["name"]]
    again = PlanHost().plan(robots, EDGES, None, "paper", **POLICY)
    assert again["fuse"] == made["fuse"]
    assert again["reason"].startswith("kept")


def test_no_robot_is_run_where_it_does_not_reach() -> None:
    robots = two_rooms()
    robots[0]["reach"] = ["e1"]
    made = PlanHost().plan(robots, EDGES, None, "recslam", **POLICY)
    assert made["slam"]["r1"] == "e1"


def test_maps_count_once_their_robots_are_placed_in_the_world() -> None:
    host = PlanHost()
    free = encode_occupancy(np.full((64, 64), FREE, np.int8))
    for name in ("r1", "r2"):
        host.put_sketch(name, 0.05, [(0, 0, free)])
    pose = FixedPose(x_um=0, y_um=0, theta_nrad=0)
    placed = {name: Placed(transform=pose, component="r1", version=1) for name in ("r1", "r2")}
    world = Transforms(world_epoch=1, final=False, resolution=0.05, robots=placed, components=())
    robots = [robot("r1", None, "e1"), robot("r2", None, "e2"), robot("r3", None, "e2")]
    overlap = decode(host.plan(robots, EDGES, encode(world), "paper", **POLICY)["overlap"])
    assert isinstance(overlap, OverlapMatrix)
    weights = overlap.weights.reshape(3, 3)
    assert weights[0, 1] == pytest.approx(0.5)
    assert weights[0, 2] == weights[1, 2] == 0.0


def test_a_robot_that_starts_nowhere_is_named_and_keeps_no_other_from_being_planned() -> None:
    robots = [*two_rooms(), robot("r5", (1e12, 0), "e1")]
    made = PlanHost().plan(robots, EDGES, None, "paper", **POLICY)
    assert made["fuse"]["r1"] == made["fuse"]["r3"] != made["fuse"]["r2"] == made["fuse"]["r4"]
    (problem,) = made["problems"]
    assert problem.startswith("robot/r5: ")


def test_a_sketch_that_is_none_leaves_the_one_before() -> None:
    host = PlanHost()
    free = encode_occupancy(np.full((64, 64), FREE, np.int8))
    host.put_sketch("r1", 0.05, [(0, 0, free)])
    with pytest.raises(BadMessage):
        host.put_sketch("r1", 0.05, [(0, 0, b"none")])
    pose = FixedPose(x_um=0, y_um=0, theta_nrad=0)
    placed = {"r1": Placed(transform=pose, component="r1", version=1)}
    world = Transforms(world_epoch=1, final=False, resolution=0.05, robots=placed, components=())
    made = host.plan([robot("r1", None, "e1"), robot("r2", None, "e2")], EDGES, encode(world), "paper", **POLICY)
    assert (made["problems"], made["predicted"]["t_c"] > 0) == ([], True)


def test_groups_are_named_so_that_most_robots_stay() -> None:
    groups, present = np.array([0, 0, 1, 1]), np.array([1, 1, 0, 1])
    reachable = np.ones((4, 2), bool)
    assert relabelled(groups, present, reachable).tolist() == [1, 1, 0, 0]


def test_groups_are_not_named_after_an_edge_that_a_member_does_not_reach() -> None:
    groups, present = np.array([0, 0, 1]), np.array([1, 1, 0])
    reachable = np.array([[True, False], [True, True], [True, True]])
    assert relabelled(groups, present, reachable).tolist() == [0, 0, 1]
