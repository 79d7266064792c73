"""All instances of an edge, by events."""

from __future__ import annotations

from edge_samples import OTHER, STREAM, frame, profile, routes

from common.wire import EndOfStream
from services.edge_worker import state as slam
from services.edge_worker.backlog import AHEAD
from services.edge_worker.instructions import Claim, Finish, Instruction, Open, Release
from services.edge_worker.phase import Phase
from services.edge_worker.state import EdgeState


def edge(workers: int = 2) -> EdgeState:
    return EdgeState("e1", workers, window=16)


def taken(state: EdgeState, *robots: str, n: int = 1) -> list[Instruction | Claim]:
    return state.handle(slam.Routed(routes(n, dict.fromkeys(robots, "e1"))))


def test_robots_are_spread_over_the_workers() -> None:
    steps = taken(edge(), "r1", "r2", "r3")
    assert [step.worker for step in steps if isinstance(step, Open)] == [0, 1, 0]
    assert Claim() in steps


def test_a_stale_table_changes_nothing() -> None:
    state = edge()
    taken(state, "r1", n=5)
    assert state.handle(slam.Routed(routes(4, {"r1": "e2"}))) == []
    assert state.counters["stale routing tables"] == 1


def test_a_robot_routed_elsewhere_is_released() -> None:
    state = edge()
    taken(state, "r1")
    steps = state.handle(slam.Routed(routes(2, {"r1": "e2"})))
    assert steps == [Release("r1", 1, 0), Claim()]
    assert not state.instances


def test_a_robot_that_the_table_does_not_name_stays() -> None:
    state = edge()
    taken(state, "r1")
    state.handle(slam.Routed(routes(2, {})))
    assert "r1" in state.instances


def test_answers_of_a_released_instance_do_not_reach_the_next_one() -> None:
    state = edge()
    taken(state, "r1")
    state.handle(slam.Routed(routes(2, {"r1": "e2"})))
    steps = taken(state, "r1", n=3)
    assert [step.life for step in steps if isinstance(step, Open)] == [2]
    assert state.handle(slam.Opened("r1", 1)) == []
    assert state.instances["r1"].phase is Phase.OPENING


def test_an_edge_started_again_counts_lives_from_elsewhere() -> None:
    again = EdgeState("e1", 1, window=16, first_life=700)
    assert [step.life for step in taken(again, "r1") if isinstance(step, Open)] == [701]


def test_an_end_told_before_the_robot_was_routed_here_counts() -> None:
    state = edge()
    state.handle(slam.Ended(EndOfStream(robot="r1", stream=STREAM, last_seq=-1)))
    taken(state, "r1")
    state.handle(slam.Opened("r1", 1))
    assert state.instances["r1"].phase is Phase.FINISHING


def test_an_end_told_before_its_streams_profile_counts() -> None:
    state = edge()
    state.handle(slam.Profiled(profile()))
    taken(state, "r1")
    state.handle(slam.Ended(EndOfStream(robot="r1", stream=OTHER, last_seq=-1)))
    assert state.instances["r1"].last_seq is None
    state.handle(slam.Profiled(profile(stream=OTHER)))
    assert state.instances["r1"].last_seq == -1


def test_only_the_frame_that_was_fed_first_is_blamed_for_a_workers_death() -> None:
    state = edge(workers=1)
    taken(state, "r1", "r2")
    for robot in ("r1", "r2"):
        state.handle(slam.Opened(robot, 1))
    state.handle(slam.FrameCame(frame(0, "r2")))
    state.handle(slam.FrameCame(frame(0, "r1")))
    state.handle(slam.WorkerDied(0))
    assert {robot: dict(each.deaths) for robot, each in state.instances.items()} == {"r1": {}, "r2": {0: 1}}


def test_a_last_refinement_that_kills_twice_is_set_aside_and_blamed_on_no_frame_of_another_robot() -> None:
    state = edge(workers=1)
    taken(state, "r1", "r2")
    state.handle(slam.Ended(EndOfStream(robot="r2", stream=STREAM, last_seq=-1)))
    refined = []
    for life in (1, 2, 3):
        steps = state.handle(slam.Opened("r2", life))
        refined += [step.refine for step in steps if isinstance(step, Finish)]
        state.handle(slam.Opened("r1", life))
        state.handle(slam.FrameCame(frame(0, "r1")))
        if life < 3:
            state.handle(slam.WorkerDied(0))
    assert refined == [True, True, False]
    assert not state.instances["r1"].deaths
    state.handle(slam.InstanceFinished("r2", 3))
    assert state.instances["r2"].phase is Phase.FINAL


def test_frames_of_robots_not_run_here_are_counted() -> None:
    state = edge()
    assert state.handle(slam.FrameCame(frame(0))) == []
    assert state.counters["frames of robots not run here"] == 1


def test_dropped_frames_stay_counted_when_their_robot_is_released() -> None:
    state = edge()
    state.handle(slam.Profiled(profile()))
    taken(state, "r1")
    state.handle(slam.FrameCame(frame(0, stream=OTHER)))
    state.handle(slam.FrameCame(frame(AHEAD)))
    counts = state.counts()
    assert (counts["frames of another stream"], counts["frames too early"]) == (1, 1)
    state.handle(slam.Routed(routes(2, {"r1": "e2"})))
    assert state.counts() == counts
    taken(state, "r1", n=3)
    assert state.counts() == counts
