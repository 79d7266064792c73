"""When the cloud shows another map, and what is in it, by events."""

from __future__ import annotations

from cloud_samples import cover, edge_notice, map_notice, only, part, routes, settled, sketched, solved

from services.cloud_merger.events import (
    Compose,
    Composed,
    EdgeMapNoticed,
    FetchPart,
    FetchSketch,
    Instruction,
    MapNoticed,
    PartFetched,
    Routed,
    SketchFetched,
    Solve,
    Solved,
    Tick,
)
from services.cloud_merger.state import PATIENCE, CloudState


def test_the_final_map_is_composed_once_every_part_is_final() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    assert part(state, "e1", "r1", 5) == []
    compose = only(Compose, part(state, "e2", "r2", 6))
    assert compose.final
    assert compose.versions == {"e1": 5, "e2": 6}
    assert set(compose.covers) == {"r1", "r2"}


def test_no_map_is_final_without_a_robot_whose_map_is_being_made_anew_elsewhere() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    state.handle(Routed(routes(2, {"r1": "e1", "r2": "e1"}, epochs={"r2": 2})))
    assert part(state, "e1", "r1", 5) == []


def test_a_final_map_that_was_made_anew_is_not_final_in_the_world_of_the_one_before() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    part(state, "e1", "r1", 5)
    part(state, "e2", "r2", 6)
    state.handle(Composed(well=True))
    notice = map_notice("r1", "e1", 2, final=True)
    steps = state.handle(MapNoticed(notice))
    covers = {"r1": notice.cover}
    edge_map = edge_notice("e1", 7, solve.above + 1, covers, final=True)
    fetch = only(FetchPart, [*state.handle(EdgeMapNoticed(edge_map)), *state.handle(Tick())])
    assert state.handle(PartFetched(fetch, 7, edge_map.world_epoch, covers, final=True)) == []
    again = only(Solve, state.handle(SketchFetched(only(FetchSketch, steps))))
    assert again.final


def test_a_composition_that_failed_is_tried_again() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    part(state, "e1", "r1", 5)
    part(state, "e2", "r2", 6)
    assert state.handle(Composed(well=False)) == []
    assert only(Compose, state.handle(Tick())).final


def test_a_robot_in_the_maps_of_two_edges_is_never_counted_twice() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"r1": "e1", "r2": "e2"})))
    sketched(state, "r1", "e1", 1)
    world = solved(only(Solve, state.handle(Tick())), {"r1": 1})
    state.handle(Solved(world))
    covers = {"r1": cover(1), "r2": cover(1)}
    for edge in ("e1", "e2"):
        state.handle(EdgeMapNoticed(edge_notice(edge, 3, world.world_epoch, covers)))
    steps = state.handle(Tick())
    for step in [step for step in steps if isinstance(step, FetchPart)]:
        came = state.handle(PartFetched(step, 3, world.world_epoch, covers, False))
        assert not [each for each in came if isinstance(each, Compose)]


def test_a_part_newer_than_its_notice_is_not_fetched_in_a_circle() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    assert state.world is not None
    notice = edge_notice("e1", 5, state.world.world_epoch, {"r1": cover(1)})
    state.handle(EdgeMapNoticed(notice))
    step = only(FetchPart, state.handle(Tick()))
    assert state.handle(PartFetched(step, 6, state.world.world_epoch, {"r1": cover(1)}, True)) == []


def test_the_map_does_not_shrink_while_edges_render_onto_a_new_world_but_does_not_wait_for_ever() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    part(state, "e1", "r1", 5)
    part(state, "e2", "r2", 6)
    state.handle(Composed(well=True))
    state.handle(Routed(routes(2, {"r1": "e1", "r2": "e2", "r3": "e2"})))
    world = solved(only(Solve, state.handle(Tick())), {"r1": 1, "r2": 1})
    state.handle(Solved(world))
    covers = {"r1": cover(1)}
    steps = state.handle(EdgeMapNoticed(edge_notice("e1", 7, world.world_epoch, covers)))
    fetch = only(FetchPart, steps or state.handle(Tick()))
    assert state.handle(PartFetched(fetch, 7, world.world_epoch, covers, False)) == []
    steps = [step for _ in range(PATIENCE) for step in state.handle(Tick())]
    assert set(only(Compose, steps).covers) == {"r1"}


def live(state: CloudState, edge: str, version: int, *robots: str) -> list[Instruction]:
    """The edge's next map of the present world is fetched; what follows of it."""
    assert state.world is not None
    covers = {robot: cover(version) for robot in robots}
    steps = state.handle(EdgeMapNoticed(edge_notice(edge, version, state.world.world_epoch, covers)))
    (fetch,) = [s for s in steps or state.handle(Tick()) if isinstance(s, FetchPart) and s.notice.edge == edge]
    return state.handle(PartFetched(fetch, version, state.world.world_epoch, covers, False))


def regrouped() -> CloudState:
    """Of a map of r1, r2 and r3, fused at e1, e1 and e2, r2 is on its way to e2: e1 does not show it any more."""
    state = CloudState(expected=("r1", "r2", "r3", "r4"))
    at = {"r1": "e1", "r2": "e1", "r3": "e2"}
    state.handle(Routed(routes(1, at)))
    for robot, edge in at.items():
        state.handle(MapNoticed(map_notice(robot, edge, 1)))
    for step in state.handle(Tick()):
        state.handle(SketchFetched(step))
    state.handle(Solved(solved(only(Solve, state.handle(Tick())), dict.fromkeys(at, 1))))
    live(state, "e1", 5, "r1", "r2")
    state.handle(Composed(well=True))
    assert set(only(Compose, live(state, "e2", 6, "r3")).covers) == {"r1", "r2", "r3"}
    state.handle(Composed(well=True))
    state.handle(Routed(routes(2, at, at | {"r2": "e2"})))
    assert live(state, "e1", 7, "r1") == []
    assert state.world is not None
    assert state.handle(Solved(state.world)) == []
    return state


def test_a_robot_between_two_fusing_edges_stays_in_the_map() -> None:
    state = regrouped()
    assert set(only(Compose, live(state, "e2", 8, "r2", "r3")).covers) == {"r1", "r2", "r3"}


def test_no_new_world_comes_before_edges_have_rendered_the_last_one() -> None:
    state = regrouped()
    live(state, "e2", 8, "r2", "r3")
    state.handle(Composed(well=True))
    sketched(state, "r1", "e1", 2)
    world = solved(only(Solve, state.handle(Tick())), {"r1": 2, "r2": 1, "r3": 1})
    state.handle(Solved(world))
    state.handle(MapNoticed(map_notice("r1", "e1", 3)))
    mine, theirs = {"r1": cover(9)}, {"r2": cover(10), "r3": cover(10)}
    state.handle(EdgeMapNoticed(edge_notice("e1", 9, world.world_epoch, mine)))
    sketch, first = state.handle(Tick())
    assert state.handle(SketchFetched(sketch)) == []
    assert state.handle(PartFetched(first, 9, world.world_epoch, mine, False)) == []
    state.handle(EdgeMapNoticed(edge_notice("e2", 10, world.world_epoch, theirs)))
    (second,) = state.handle(Tick())
    assert state.changed
    compose = only(Compose, state.handle(PartFetched(second, 10, world.world_epoch, theirs, False)))
    assert set(compose.covers) == {"r1", "r2", "r3"}
    assert only(Solve, state.handle(Tick()))


def test_the_map_does_not_wait_for_ever_for_a_robot_that_does_not_come_back() -> None:
    state = regrouped()
    steps = [step for _ in range(PATIENCE + 1) for step in state.handle(Tick())]
    assert set(only(Compose, steps).covers) == {"r1", "r3"}


def test_a_robot_that_is_routed_no_more_is_not_waited_for() -> None:
    state = regrouped()
    state.handle(Routed(routes(3, {"r1": "e1", "r3": "e2"})))
    steps = [step for step in state.handle(Tick()) if isinstance(step, Compose)]
    assert set(only(Compose, steps).covers) == {"r1", "r3"}
