"""What the cloud fetches and solves, by events; and any order of them."""

from __future__ import annotations

from cloud_samples import (
    Cluster,
    cover,
    edge_notice,
    map_notice,
    only,
    part,
    routes,
    settled,
    sketched,
    solved,
    verdicts,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from services.cloud_merger.events import (
    Compose,
    EdgeMapNoticed,
    FetchFailed,
    FetchPart,
    FetchSketch,
    Forget,
    MapNoticed,
    PartFetched,
    Routed,
    SketchFetched,
    Solve,
    Solved,
    Tick,
    VerdictsCame,
)
from services.cloud_merger.state import CloudState


def test_a_sketch_is_fetched_only_from_the_robots_present_owner() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"r1": "e1"})))
    assert state.handle(MapNoticed(map_notice("r1", "e2", 1, final=True))) == []
    assert state.handle(MapNoticed(map_notice("r1", "e1", 1, True, (1, 9)))) == []
    assert state.handle(MapNoticed(map_notice("r1", "e1", 1, final=True))) != []


def test_a_failed_fetch_is_tried_again_at_the_next_tick() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"r1": "e1"})))
    step = only(FetchSketch, state.handle(MapNoticed(map_notice("r1", "e1", 1, final=True))))
    assert state.handle(Tick()) == []
    state.handle(FetchFailed(step))
    only(FetchSketch, state.handle(Tick()))


def test_nothing_is_final_before_every_expected_robot_has_come() -> None:
    state = CloudState(expected=("r1", "r2"))
    state.handle(Routed(routes(1, {"r1": "e1"})))
    assert sketched(state, "r1", "e1", 1, final=True) == []
    assert not only(Solve, state.handle(Tick())).final


def test_the_final_world_is_solved_as_soon_as_all_maps_are_final() -> None:
    _, solve = settled()
    assert (solve.robots, solve.pairs, solve.final) == (("r1", "r2"), (("r1", "r2"),), True)


def test_the_final_world_waits_for_the_edges_final_verdicts() -> None:
    state = CloudState(expected=("r1", "r2"))
    state.handle(Routed(routes(1, {"r1": "e1", "r2": "e1"})))
    sketched(state, "r1", "e1", 1, final=True)
    sketched(state, "r2", "e1", 1, final=True)
    state.handle(VerdictsCame("e1", verdicts("e1", ("r1", "r2"), versions=(0, 1))))
    assert not state.ready_to_settle()
    steps = state.handle(VerdictsCame("e1", verdicts("e1", ("r1", "r2"))))
    solve = only(Solve, steps)
    assert solve.final
    assert [(each.a, each.b) for each in solve.verdicts] == [("r1", "r2")]
    assert solve.pairs == (("r1", "r2"),)  # all: which need a search is told from all maps


def test_a_solve_that_failed_is_tried_again() -> None:
    state, _ = settled()
    state.handle(Solved(None))
    assert only(Solve, state.handle(Tick())).final


def test_a_new_world_is_above_any_that_an_edge_has_rendered() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"r1": "e1"})))
    state.handle(EdgeMapNoticed(edge_notice("e1", 3, 41, {"r1": cover(1)})))
    sketched(state, "r1", "e1", 1)
    steps = state.handle(Tick())
    assert only(Solve, steps).above >= 41


def test_a_map_rendered_onto_a_world_that_died_with_an_earlier_cloud_is_not_composed() -> None:
    state, covers = CloudState(), {"r1": cover(1)}
    state.handle(Routed(routes(1, {"r1": "e1"})))
    sketched(state, "r1", "e1", 1)
    state.handle(EdgeMapNoticed(edge_notice("e1", 3, 41, covers)))
    solve, fetch = sorted(state.handle(Tick()), key=lambda step: isinstance(step, FetchPart))
    world = solved(solve, {"r1": 1})
    state.handle(Solved(world))
    for version, epoch in ((3, 41), (4, 42), (5, 43)):
        assert state.handle(PartFetched(fetch, version, epoch, covers, final=False)) == []
        state.handle(EdgeMapNoticed(edge_notice("e1", version + 1, epoch + 1, covers)))
        fetch = only(FetchPart, state.handle(Tick()))
    assert only(Compose, state.handle(PartFetched(fetch, 6, world.world_epoch, covers, final=False)))


def test_of_a_pair_only_the_edge_that_fuses_both_now_is_heard() -> None:
    state, slam = CloudState(), dict.fromkeys(("r1", "r2", "r3"), "e1")
    state.handle(Routed(routes(1, slam, dict.fromkeys(slam, "e2"))))
    state.handle(VerdictsCame("e2", verdicts("e2", ("r1", "r2"), ("r1", "r3"), ("r2", "r3"), versions=(1, 1))))
    state.handle(Routed(routes(2, slam, {"r1": "e1", "r2": "e1", "r3": "e2"})))
    state.handle(VerdictsCame("e1", verdicts("e1", ("r1", "r2"), versions=(2, 2))))
    sketched(state, "r1", "e1", 2)
    (told,) = only(Solve, state.handle(Tick())).verdicts
    assert (told.a, told.b, told.versions) == ("r1", "r2", (2, 2))


def test_a_robot_routed_no_more_is_forgotten() -> None:
    state, _ = settled()
    assert state.handle(Routed(routes(2, {"r1": "e1"}))) == [Forget("r2")]


def test_after_the_death_of_the_merging_process_all_is_fetched_and_solved_again() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    part(state, "e1", "r1", 5)
    again = state.empty_handed()
    steps = again.handle(Tick())
    sketches = [step for step in steps if isinstance(step, FetchSketch)]
    assert [step.notice.robot for step in sketches] == ["r1", "r2"]
    assert only(FetchPart, steps).since == 0
    last = [step for each in sketches for step in again.handle(SketchFetched(each))]
    assert only(Solve, last).final
    assert again.handle(FetchFailed(sketches[0])) == []


def test_a_later_final_map_makes_another_final_world() -> None:
    state, solve = settled()
    state.handle(Solved(solved(solve, {"r1": 1, "r2": 1})))
    assert only(Solve, sketched(state, "r1", "e1", 2, final=True)).final


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.integers(0, 150), robots=st.integers(1, 4), edges=st.integers(1, 3))
def test_whatever_happens_before_the_end_is_one_final_map_of_everybody(
    seed: int, steps: int, robots: int, edges: int
) -> None:
    cluster = Cluster(seed, tuple(f"r{k}" for k in range(robots)), tuple(f"e{k}" for k in range(edges)))
    rng = cluster.random
    cluster.route()
    for _ in range(steps):
        choice = rng.random()
        if choice < 0.3:
            cluster.tell_map(rng.choice(cluster.robots), rng.random() < 0.4)
        elif choice < 0.35:
            cluster.move()
        elif choice < 0.5:
            cluster.fuse_edge(rng.choice(cluster.edges))
        elif choice < 0.6:
            cluster.give(Tick())
        else:
            cluster.carry_out(fail=rng.random() < 0.2)
    cluster.settle()
    for compose in cluster.composed:
        if compose.final:
            assert set(compose.covers) == set(cluster.robots)
    last, finals = cluster.composed[-1], [solve for solve in cluster.solves if solve.final]
    assert last.final
    assert dict(last.covers) == {robot: cluster.maps[robot].cover for robot in cluster.robots}
    assert finals[-1].robots == cluster.robots
    decided = {*finals[-1].pairs, *((each.a, each.b) for each in finals[-1].verdicts)}
    assert decided == {(a, b) for a in cluster.robots for b in cluster.robots if a < b}
    assert all(each.final for each in finals[-1].verdicts)
