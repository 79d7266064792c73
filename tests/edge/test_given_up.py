"""A robot that is gone for good is not waited for, and one that comes back goes on, by events."""

from __future__ import annotations

from edge_samples import STREAM, frame, profile, routes

from common.presence import Linked, RobotSeen
from common.wire import EndOfStream
from services.edge_worker import state as slam
from services.edge_worker.instructions import Claim, Finish, GiveUp, Instruction, Keep, Open
from services.edge_worker.phase import Phase
from services.edge_worker.state import EdgeState

LEASE_S = 60.0


def left(*seqs: int) -> EdgeState:
    """r1 was there, its frames `seqs` have come, and at time 100 it is gone."""
    state = EdgeState("e1", 1, window=16, lease_s=LEASE_S, keep_s=1000.0)
    state.handle(RobotSeen("r1", True, 0.0))
    state.handle(slam.Routed(routes(1, {"r1": "e1"})))
    state.handle(slam.Opened("r1", 1))
    state.handle(slam.PageCame("r1", 1, STREAM, (), 0, None))
    for seq in seqs:
        state.handle(slam.FrameCame(frame(seq)))
    for seq in seqs:
        state.handle(slam.FrameDone("r1", 1, seq))
    state.handle(RobotSeen("r1", False, 100.0))
    state.handle(slam.Tick(100.1))
    state.handle(slam.FetchFailed("r1", 1))
    return state


def given_up(steps: list[Instruction | Claim]) -> list[int]:
    return [step.seq for step in steps if isinstance(step, GiveUp)]


def test_a_robot_that_is_gone_for_longer_than_the_lease_ends_at_its_last_frame() -> None:
    state = left(0, 1)
    assert not given_up(state.handle(slam.Tick(100.0 + LEASE_S)))
    steps = state.handle(slam.Tick(100.5 + LEASE_S))
    assert given_up(steps) == [1]
    assert any(isinstance(step, Finish) for step in steps)
    state.handle(slam.InstanceFinished("r1", 1))
    instance = state.instances["r1"]
    assert (instance.phase, instance.given_up, instance.processed) == (Phase.FINAL, True, 1)
    assert not given_up(state.handle(slam.Tick(500.0)))


def test_nobody_is_given_up_while_the_router_is_away_nor_before_the_lease_has_passed_since_its_return() -> None:
    state = left(0)
    state.handle(Linked(False, 101.0))
    assert not given_up(state.handle(slam.Tick(900.0)))
    state.handle(Linked(True, 900.0))
    assert not given_up(state.handle(slam.Tick(900.0 + LEASE_S)))
    assert given_up(state.handle(slam.Tick(900.1 + LEASE_S))) == [0]


def test_a_robot_that_comes_back_goes_on_from_before_the_last_refinement() -> None:
    state = left(0, 1)
    steps = state.handle(slam.Tick(200.0))
    assert [type(step) for step in steps if isinstance(step, Keep | Finish)] == [Keep, Finish]
    (kept,) = [step.checkpoint for step in steps if isinstance(step, Keep)]
    state.handle(slam.InstanceFinished("r1", 1))
    (step,) = state.handle(RobotSeen("r1", True, 300.0))
    assert isinstance(step, Open)
    state.handle(slam.Opened("r1", 2, kept))
    instance = state.instances["r1"]
    assert (instance.phase, instance.processed, instance.given_up) == (Phase.RUNNING, 1, False)
    state.handle(slam.PageCame("r1", 2, STREAM, (frame(2),), 0, None))
    assert list(instance.in_flight) == [2]


def test_a_map_that_left_out_frames_which_the_robot_may_bring_back_is_not_gone_on_from() -> None:
    state = left(0, 2)
    steps = state.handle(slam.Tick(200.0))
    assert given_up(steps) == [2]
    steps += state.handle(slam.FrameDone("r1", 1, 2))
    assert not [step for step in steps if isinstance(step, Keep)]
    state.handle(slam.InstanceFinished("r1", 1))
    assert state.instances["r1"].backlog.gaps == 1
    assert [type(step) for step in state.handle(RobotSeen("r1", True, 300.0))] == [Open]


def test_an_end_that_was_told_counts_again_once_the_robot_is_back() -> None:
    state = left(0)
    state.handle(slam.Ended(EndOfStream(robot="r1", stream=STREAM, last_seq=4)))
    assert given_up(state.handle(slam.Tick(200.0))) == [0]
    state.handle(slam.InstanceFinished("r1", 1))
    state.handle(RobotSeen("r1", True, 300.0))
    assert state.instances["r1"].last_seq == 4


def test_of_a_robot_that_was_gone_before_anything_was_heard_an_empty_map_is_final() -> None:
    state = EdgeState("e1", 1, window=16, lease_s=LEASE_S)
    state.handle(slam.Routed(routes(1, {"r1": "e1"})))
    state.handle(slam.Opened("r1", 1))
    state.handle(slam.FetchFailed("r1", 1))
    state.handle(slam.Tick(10.0))
    assert given_up(state.handle(slam.Tick(10.1 + LEASE_S))) == [-1]
    state.handle(slam.InstanceFinished("r1", 1))
    assert state.instances["r1"].phase is Phase.FINAL
    steps = state.handle(slam.Profiled(profile()))
    assert [step.stream for step in steps if isinstance(step, Open)] == [STREAM]


def test_a_gone_robot_is_given_up_again_when_its_worker_dies_afterwards() -> None:
    state = left(0, 1)
    state.handle(slam.Tick(200.0))
    state.handle(slam.InstanceFinished("r1", 1))
    state.handle(slam.WorkerDied(0))
    state.handle(slam.Opened("r1", 2))
    state.handle(slam.FetchFailed("r1", 2))
    assert given_up(state.handle(slam.Tick(201.0))) == [-1]
