"""Who is placed where, when robots and edges come and go, by events."""

from __future__ import annotations

from collections import Counter

from scheduler_samples import GRACE, come, profile, scheduler, table, tell

from common.presence import Linked, RobotSeen
from services.scheduler.events import EdgeSeen, Profiled, Publish, Tick
from services.scheduler.state import SETTLE_S, SchedulerState
from services.scheduler.topology import Topology


def test_a_robot_is_placed_on_the_edge_with_the_least_load() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    assert table(come(state, "r2")).routes["r2"].slam_edge == "e2"


def test_a_robot_is_placed_only_where_it_reaches() -> None:
    state = scheduler("e1", "e2")
    assert table(come(state, "r1", "e2")).routes["r1"].slam_edge == "e2"


def test_a_robot_is_not_placed_before_its_profile_tells_what_it_reaches() -> None:
    state = scheduler("e1", "e2")
    assert tell(state, RobotSeen("r1", True, 1.0), now=1.0) == []
    assert table(tell(state, Profiled(profile("r1", "e2"), 1.0), now=1.0)).routes["r1"].slam_edge == "e2"


def test_robots_that_come_at_once_are_one_table_and_spread_over_the_edges() -> None:
    state = scheduler("e1", "e2")
    for number in range(50):
        assert state.handle(Profiled(profile(f"r{number}"), 1.0)) == []
        assert state.handle(RobotSeen(f"r{number}", True, 1.0)) == []
    (step,) = state.handle(Tick(1.1))
    assert isinstance(step, Publish)
    assert Counter(route.slam_edge for route in step.routes.routes.values()) == {"e1": 25, "e2": 25}
    assert step.reason.endswith("; and 18 more")


def test_a_robot_that_reaches_no_edge_is_named_until_one_comes() -> None:
    state = scheduler("e1")
    assert come(state, "r1", "e9") == []
    assert state.stranded == {"r1"}
    assert table(tell(state, EdgeSeen("e9", True, 2.0), now=2.0)).routes["r1"].slam_edge == "e9"
    assert state.stranded == set()


def test_a_robot_whose_only_edge_is_back_is_named_no_more() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1", "e2")
    state.handle(EdgeSeen("e2", False, 10.0))
    state.handle(Tick(10.1 + GRACE))
    assert state.stranded == {"r1"}
    state.handle(EdgeSeen("e2", True, 20.0))
    assert state.handle(Tick(20.1)) == []
    assert state.stranded == set()


def test_a_robot_that_has_left_without_a_route_is_named_no_more() -> None:
    state = scheduler("e1")
    come(state, "r1", "e9")
    tell(state, RobotSeen("r1", False, 5.0), now=5.0)
    assert state.stranded == set()


def test_the_first_placing_waits_for_the_expected_edges_but_not_for_ever() -> None:
    state = SchedulerState(Topology("recslam"), ("e1", "e2"), GRACE)
    state.handle(EdgeSeen("e1", True, 0.0))
    assert come(state, "r1") == []
    assert table(state.handle(Tick(SETTLE_S + 0.1))).routes["r1"].slam_edge == "e1"


def test_a_robot_that_left_keeps_its_route() -> None:
    state = scheduler("e1")
    come(state, "r1")
    assert state.handle(RobotSeen("r1", False, 2.0)) == []
    assert state.handle(Tick(100.0)) == []
    assert "r1" in state.routes


def test_an_edge_that_is_back_within_the_grace_time_keeps_its_robots() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    state.handle(EdgeSeen("e1", False, 10.0))
    assert state.handle(Tick(10.0 + GRACE - 0.1)) == []
    state.handle(EdgeSeen("e1", True, 12.9))
    assert state.handle(Tick(100.0)) == []


def test_the_robots_of_an_edge_that_is_gone_move_under_a_new_epoch() -> None:
    state = scheduler("e1", "e2")
    before = table(come(state, "r1")).routes["r1"]
    state.handle(EdgeSeen("e1", False, 10.0))
    after = table(state.handle(Tick(10.1 + GRACE))).routes["r1"]
    assert (before.slam_edge, after.slam_edge) == ("e1", "e2")
    assert after.epoch > before.epoch


def test_a_robot_that_comes_is_not_placed_on_an_edge_that_has_just_died() -> None:
    state = scheduler("e1", "e2")
    state.handle(EdgeSeen("e1", False, 1.0))
    assert table(come(state, "r1", now=1.1)).routes["r1"].slam_edge == "e2"


def test_nobody_is_declared_gone_while_the_router_is_lost_nor_within_the_grace_after() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    state.handle(EdgeSeen("e1", False, 10.0))
    state.handle(Linked(False, 10.0))
    assert state.handle(Tick(500.0)) == []
    state.handle(Linked(True, 500.0))
    assert state.handle(Tick(500.0 + GRACE - 0.1)) == []
    assert table(state.handle(Tick(500.1 + GRACE))).routes["r1"].slam_edge == "e2"
