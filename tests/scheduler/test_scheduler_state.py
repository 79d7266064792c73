"""A scheduler started again; and any order of comings, goings and outages."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st
from scheduler_samples import GRACE, come, profile, scheduler, table

from common.presence import Linked, RobotSeen
from common.wire import Claims
from services.scheduler.events import Claimed, EdgeSeen, Event, Interval, MakePlan, Planned, Profiled, Tick
from services.scheduler.state import SchedulerState
from services.scheduler.topology import Topology


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
                assert state.link.up
                assert now - up_since > GRACE
                continue
            assert step.routes.epoch > epoch
            epoch = step.routes.epoch
            if isinstance(event, Claimed):
                continue
            assert state.link.up
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
            if up != state.link.up:
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
