"""What of a plan gets into the routing table, by events."""

from __future__ import annotations

import pytest
from scheduler_samples import GRACE, come, scheduler, table

from common.presence import Linked, RobotSeen
from services.scheduler.events import EdgeSeen, Interval, MakePlan, PlanFailed, Planned, Relieved


def test_nothing_is_planned_until_everybody_could_be_back_after_an_outage() -> None:
    state = scheduler("e1", "e2", "e3")
    come(state, "r1")
    come(state, "r2")
    state.handle(Linked(False, 10.0))
    state.handle(EdgeSeen("e3", False, 10.0))
    state.handle(Linked(True, 20.0))
    assert state.handle(Interval(20.5)) == []
    assert state.handle(Interval(20.1 + GRACE)) != []


def test_a_plan_made_for_another_table_is_dropped() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    come(state, "r2")
    (plan,) = state.handle(Interval(5.0))
    assert isinstance(plan, MakePlan)
    come(state, "r3", now=5.1)
    assert state.handle(Planned(plan.epoch, {}, {"r1": "e2"}, 5.2)) == []
    assert state.counters["plans overtaken by events"] == 1


def test_a_plan_that_names_an_edge_that_has_died_is_dropped() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    come(state, "r2")
    (plan,) = state.handle(Interval(5.0))
    assert isinstance(plan, MakePlan)
    state.handle(EdgeSeen("e2", False, 5.1))
    assert state.handle(Planned(plan.epoch, {}, {"r1": "e2", "r2": "e2"}, 5.2)) == []


def test_fusing_elsewhere_keeps_the_epoch_and_running_elsewhere_raises_it() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    old = table(come(state, "r2")).routes
    slam, fuse = {"r2": "e1"}, {"r1": "e2", "r2": "e2"}
    assert state.handle(Planned(state.epoch, slam, fuse, 5.0)) == []
    new = table(state.handle(Planned(state.epoch, slam, fuse, 8.0))).routes
    assert (new["r1"].fuse_edge, new["r1"].epoch) == ("e2", old["r1"].epoch)
    assert (new["r2"].slam_edge, new["r2"].epoch) == ("e1", state.epoch)


@pytest.mark.parametrize("what", ["slam", "fuse"])
def test_a_robot_is_run_or_fused_elsewhere_only_when_two_plans_in_a_row_say_so(what: str) -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    come(state, "r2")

    def plan(edge: str) -> Planned:
        asked = {"slam": {"r1": "e1"}, "fuse": {"r1": "e1"}} | {what: {"r1": edge}}
        return Planned(state.epoch, asked["slam"], asked["fuse"], 5.0)

    for edge in ("e2", "e1", "e2"):
        assert state.handle(plan(edge)) == []
    route = table(state.handle(plan("e2"))).routes["r1"]
    assert (route.slam_edge if what == "slam" else route.fuse_edge) == "e2"


def test_a_plan_that_failed_lets_the_next_one_be_made() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    come(state, "r2")
    state.handle(Interval(5.0))
    assert state.handle(Interval(6.0)) == []
    state.handle(PlanFailed())
    assert state.handle(Interval(7.0)) != []


def test_a_robot_that_has_left_is_fused_elsewhere_but_its_map_stays_where_it_was_made() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    come(state, "r2")
    old = state.routes["r1"]
    state.handle(RobotSeen("r1", False, 4.0))
    plan = Planned(state.epoch, {"r1": "e2"}, {"r1": "e2"}, 5.0)
    state.handle(plan)
    new = table(state.handle(plan)).routes["r1"]
    assert (new.slam_edge, new.fuse_edge, new.epoch) == (old.slam_edge, "e2", old.epoch)
    assert state.handle(Relieved("e1", {"r1": "e2"}, "e1 cannot keep up", 6.0)) == []
