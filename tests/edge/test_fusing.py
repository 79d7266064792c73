"""Whose maps an edge fetches and when it fuses, by events."""

from __future__ import annotations

import random

from edge_samples import cover, notice, routes
from hypothesis import given, settings
from hypothesis import strategies as st

from common.wire import Transforms
from services.edge_worker.fusing import (
    Event,
    Fetch,
    Fetched,
    FetchFailed,
    Forget,
    Fuse,
    Fused,
    FusingState,
    Instruction,
    MapNoticed,
    Routed,
    Tick,
    WorldSeen,
)


def world(epoch: int, final: bool = False) -> Transforms:
    return Transforms(world_epoch=epoch, final=final, resolution=0.05, robots={}, components=())


def fusing(*robots: str) -> FusingState:
    state = FusingState("e1")
    state.handle(Routed(routes(1, dict.fromkeys(robots, "e2"), dict.fromkeys(robots, "e1"))))
    state.changed = False
    return state


def only_fetch(steps: list[Instruction]) -> Fetch:
    (step,) = steps
    assert isinstance(step, Fetch)
    return step


def fetched(state: FusingState, robot: str, version: int, final: bool = False) -> list[Instruction]:
    state.handle(MapNoticed(notice(robot, "e2", version, final)))
    step = state.fetching.get(robot) or only_fetch(state.handle(Tick()))
    return state.handle(Fetched(step, version, cover(9), final))


def test_a_map_is_fetched_from_the_edge_that_runs_the_robot() -> None:
    state = fusing("r1")
    state.handle(MapNoticed(notice("r1", "e2", 3)))
    step = only_fetch(state.handle(Tick()))
    assert (step.notice.edge, step.since) == ("e2", 0)


def test_a_notice_of_another_edge_or_epoch_fetches_nothing() -> None:
    state = fusing("r1")
    state.handle(MapNoticed(notice("r1", "e3", 3, final=True)))
    state.handle(MapNoticed(notice("r1", "e2", 3, final=True, epoch=(1, 7))))
    assert state.handle(Tick()) == []


def test_only_what_has_changed_since_is_asked_for() -> None:
    state = fusing("r1")
    fetched(state, "r1", 3)
    state.handle(Tick())
    state.handle(Fused(well=True))
    state.handle(MapNoticed(notice("r1", "e2", 5)))
    assert only_fetch(state.handle(Tick())).since == 3


def test_a_final_map_is_fetched_without_waiting_for_the_tick() -> None:
    assert only_fetch(fusing("r1").handle(MapNoticed(notice("r1", "e2", 3, final=True)))).since == 0


def test_a_map_newer_than_its_notice_is_not_fetched_in_a_circle() -> None:
    state = fusing("r1", "r2")
    state.handle(MapNoticed(notice("r1", "e2", 3)))
    step = only_fetch(state.handle(Tick()))
    assert state.handle(Fetched(step, 4, cover(9), False)) == []


def test_a_map_that_comes_after_a_re_routing_is_forgotten() -> None:
    state = fusing("r1")
    state.handle(MapNoticed(notice("r1", "e2", 3)))
    step = only_fetch(state.handle(Tick()))
    state.handle(Routed(routes(2, {"r1": "e3"}, {"r1": "e1"}, {"r1": 2})))
    assert state.handle(Fetched(step, 3, cover(9), False)) == [Forget("r1")]
    assert state.held == {}


def test_a_map_made_under_another_epoch_than_noticed_is_not_fused() -> None:
    state = fusing("r1")
    state.handle(MapNoticed(notice("r1", "e2", 3)))
    step = only_fetch(state.handle(Tick()))
    assert state.handle(Fetched(step, 3, cover(9, (1, 2)), False)) == [Forget("r1")]


def test_a_failed_fetch_is_tried_again_at_the_next_tick() -> None:
    state = fusing("r1")
    state.handle(MapNoticed(notice("r1", "e2", 3)))
    step = only_fetch(state.handle(Tick()))
    assert state.handle(FetchFailed(step)) == []
    assert only_fetch(state.handle(Tick())).notice.version == 3


def test_fusion_runs_one_at_a_time_and_again_when_something_has_changed() -> None:
    state = fusing("r1", "r2")
    fetched(state, "r1", 3)
    assert state.handle(Tick()) == [Fuse(("r1",), None, whole=False)]
    fetched(state, "r2", 3)
    assert state.handle(Tick()) == []
    state.handle(Fused(well=True))
    assert state.handle(Tick()) == [Fuse(("r1", "r2"), None, whole=True)]
    state.handle(Fused(well=True))
    assert state.handle(Tick()) == []


def test_the_last_final_map_is_fused_at_once() -> None:
    state = fusing("r1", "r2")
    fetched(state, "r1", 3, final=True)
    assert fetched(state, "r2", 3, final=True) == [Fuse(("r1", "r2"), None, whole=True)]


def test_the_final_world_is_rendered_at_once_also_when_a_fusion_is_under_way() -> None:
    state = fusing("r1")
    fetched(state, "r1", 3, final=True)
    assert state.handle(WorldSeen(world(4, final=True))) == []
    (step,) = state.handle(Fused(well=True))
    assert isinstance(step, Fuse)
    assert step.world is not None
    assert step.world.final


def test_a_failed_fusion_is_tried_again_at_the_next_tick_not_at_once() -> None:
    state = fusing("r1")
    fetched(state, "r1", 3, final=True)
    assert state.handle(Fused(well=False)) == []
    assert state.handle(Tick()) == [Fuse(("r1",), None, whole=True)]


def test_a_robot_that_is_fused_elsewhere_now_is_forgotten_and_leaves_the_edge_map() -> None:
    state = fusing("r1")
    fetched(state, "r1", 3)
    state.handle(Tick())
    state.handle(Fused(well=True))
    assert state.handle(Routed(routes(2, {"r1": "e2"}, {"r1": "e2"}))) == [Forget("r1")]
    assert state.handle(Tick()) == [Fuse((), None, whole=False)]


def test_a_stale_table_changes_nothing() -> None:
    state = fusing("r1")
    state.handle(Routed(routes(5, {"r1": "e2"}, {"r1": "e1"})))
    state.handle(Routed(routes(4, {})))
    assert set(state.members) == {"r1"}


EDGES = ("e1", "e2", "e3")


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.integers(0, 120))
def test_whatever_the_order_all_final_maps_are_fused_in_the_final_world(seed: int, steps: int) -> None:
    rng = random.Random(seed)
    state, robots = FusingState("e1"), ("r1", "r2", "r3")
    table = 1
    inside: dict[str, int] = {}
    owners = dict.fromkeys(robots, ("e2", 1))
    pending: list[Instruction] = []
    shown: list[Fuse] = []

    def give(event: Event) -> None:
        pending.extend(state.handle(event))
        state.validate()

    def carry_out(fail: bool) -> None:
        """The shell does one thing after the other."""
        if not pending:
            return
        match pending.pop(0):
            case Fetch(told, since) as step:
                if fail:
                    give(FetchFailed(step))
                    return
                robot = told.robot
                assert since in (0, inside.get(robot)), "a delta is put onto what it does not follow"
                inside[robot] = told.version
                give(Fetched(step, told.version, cover(9, told.epoch), told.final))
            case Forget(robot):
                inside.pop(robot, None)
            case Fuse() as step:
                shown.append(step)
                give(Fused(well=not fail))

    def reroute(fused_at: dict[str, str]) -> None:
        nonlocal table
        table += 1
        for robot in robots:
            if rng.random() < 0.3:
                owners[robot] = (rng.choice(EDGES), table)
        slam = {robot: edge for robot, (edge, _) in owners.items()}
        give(Routed(routes(table, slam, fused_at, {robot: epoch for robot, (_, epoch) in owners.items()})))

    def tell(robot: str, version: int, final: bool) -> None:
        edge, epoch = owners[robot]
        give(MapNoticed(notice(robot, edge, version, final, (1, epoch))))

    for version in range(1, steps):
        choice = rng.random()
        if choice < 0.3:
            tell(rng.choice(robots), version, rng.random() < 0.3)
        elif choice < 0.4:
            reroute({robot: rng.choice(EDGES[:2]) for robot in robots})
        elif choice < 0.5:
            give(WorldSeen(world(version, rng.random() < 0.5)))
        elif choice < 0.6:
            give(Tick())
        else:
            carry_out(rng.random() < 0.3)
    reroute(dict.fromkeys(robots, "e1"))
    for robot in robots:
        tell(robot, 1000, final=True)
    give(WorldSeen(world(1000, final=True)))
    for _ in range(20):
        give(Tick())
        while pending:
            carry_out(False)
    assert shown[-1] == Fuse(robots, world(1000, final=True), whole=True)
    assert inside == dict.fromkeys(robots, 1000)
    assert state.all_final()
