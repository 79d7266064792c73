"""Who is routed where, by events; and any order of comings, goings and outages."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.wire import Claims, RobotProfile, Routes
from services.scheduler.events import (
    Claimed,
    EdgeSeen,
    Event,
    Instruction,
    Interval,
    Linked,
    MakePlan,
    PlanFailed,
    Planned,
    Profiled,
    Publish,
    RobotSeen,
    Tick,
)
from services.scheduler.state import (
    SETTLE_S,
    SchedulerState,
)
from services.scheduler.topology import Topology

GRACE = 3.0


def scheduler(*edges: str, topology: str = "recslam") -> SchedulerState:
    """With these edges up since time 0."""
    state = SchedulerState(Topology(topology), edges, GRACE)
    for edge in edges:
        state.handle(EdgeSeen(edge, True, 0.0))
    return state


def profile(robot: str, *edges: str) -> RobotProfile:
    return RobotProfile(robot=robot, stream="a" * 32, edges=edges or None)


def tell(state: SchedulerState, *events: Event, now: float) -> list[Instruction]:
    """What comes of these events and of the tick after them."""
    return [step for event in (*events, Tick(now)) for step in state.handle(event)]


def come(state: SchedulerState, robot: str, *edges: str, now: float = 1.0) -> list[Instruction]:
    return tell(state, Profiled(profile(robot, *edges), now), RobotSeen(robot, True, now), now=now)


def table(steps: list[Instruction]) -> Routes:
    (step,) = [step for step in steps if isinstance(step, Publish)]
    return step.routes


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


def test_a_scheduler_started_again_leaves_robots_where_they_run_and_fences_the_old_one_off() -> None:
    state = SchedulerState(Topology("recslam"), ("e1", "e2"), GRACE)
    claims = (Claims(edge="e2", claims={"r1": (1, 3)}, epoch=(1, 9)), Claims(edge="e1", claims={}, epoch=(1, 8)))
    routes = table(state.handle(Claimed(claims, 0.0)))
    assert routes.epoch > (1, 9)
    assert (routes.routes["r1"].slam_edge, routes.routes["r1"].epoch) == ("e2", (1, 3))
    state.handle(EdgeSeen("e1", True, 0.1))
    assert come(state, "r1", now=0.2) == []
    state.handle(EdgeSeen("e2", True, 0.3))
    assert state.handle(Tick(100.0)) == []


def test_of_two_edges_that_claim_a_robot_the_later_epoch_has_it() -> None:
    state = scheduler("e1", "e2")
    claims = (Claims(edge="e2", claims={"r1": (1, 5)}), Claims(edge="e1", claims={"r1": (1, 3)}))
    assert table(state.handle(Claimed(claims, 0.0))).routes["r1"].slam_edge == "e2"


def test_an_edge_that_heard_a_later_table_than_ours_raises_the_term_whenever_it_speaks() -> None:
    state = scheduler("e1", "e2")
    come(state, "r1")
    steps = state.handle(Claimed((Claims(edge="e2", claims={}, epoch=(4, 2)),), 9.0))
    assert table(steps).epoch == (5, 1)


def test_the_claims_of_our_own_table_change_nothing() -> None:
    state = scheduler("e1")
    routes = table(come(state, "r1"))
    claims = Claims(edge="e1", claims={"r1": routes.routes["r1"].epoch}, epoch=routes.epoch)
    assert state.handle(Claimed((claims,), 2.0)) == []


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.integers(1, 200))
def test_no_table_names_an_unreachable_or_absent_edge_and_epochs_only_rise(seed: int, steps: int) -> None:
    rng = random.Random(seed)
    edges, robots = ("e1", "e2", "e3"), ("r1", "r2", "r3", "r4")
    reach = {robot: tuple(rng.sample(edges, rng.randint(1, 3))) for robot in robots}
    state = SchedulerState(Topology("recslam"), edges[: rng.randint(0, 3)], GRACE)
    now, epoch, up_since = 0.0, (0, 0), float("-inf")
    plans: list[MakePlan] = []

    def give(event: Event) -> None:
        nonlocal epoch
        before, alive = dict(state.routes), {e for e, seen in state.edges.items() if seen.alive}
        known = dict(state.edges)
        for step in state.handle(event):
            if isinstance(step, MakePlan):
                plans.append(step)
                assert state.link_up
                assert now - up_since > GRACE
                continue
            assert step.routes.epoch > epoch
            epoch = step.routes.epoch
            if isinstance(event, Claimed):
                continue
            assert state.link_up
            for robot, route in step.routes.routes.items():
                old = before.get(robot)
                if old is None or old.slam_edge != route.slam_edge:
                    assert route.slam_edge in reach[robot]
                    assert route.slam_edge in alive or state.edges[route.slam_edge].alive
                    assert route.epoch == epoch
                if old is not None and old.slam_edge != route.slam_edge and not isinstance(event, Planned):
                    seen = known[old.slam_edge]
                    lost = not seen.alive and now - seen.since > GRACE and now - up_since > GRACE
                    assert lost or old.slam_edge not in reach[robot]
        state.validate()

    for _ in range(steps):
        now += rng.choice((0.0, 0.1, 1.0, 4.0))
        choice = rng.random()
        if choice < 0.2:
            robot = rng.choice(robots)
            give(Profiled(profile(robot, *reach[robot]), now))
        elif choice < 0.35:
            give(RobotSeen(rng.choice(robots), rng.random() < 0.7, now))
        elif choice < 0.6:
            give(EdgeSeen(rng.choice(edges), rng.random() < 0.6, now))
        elif choice < 0.66:
            up = rng.random() < 0.6
            if up != state.link_up:
                up_since = now
            give(Linked(up, now))
        elif choice < 0.7:
            edge, robot = rng.choice(edges), rng.choice(robots)
            heard = (rng.randint(0, 3), rng.randint(0, 9))
            give(Claimed((Claims(edge=edge, claims={robot: heard}, epoch=heard),), now))
        elif choice < 0.8:
            give(Interval(now))
        elif choice < 0.9 and plans:
            plan = plans.pop()
            slam = {robot: rng.choice(plan.edges) for robot in plan.robots}
            give(Planned(plan.epoch, slam, {robot: rng.choice(plan.edges) for robot in plan.robots}, now))
        else:
            give(Tick(now))
