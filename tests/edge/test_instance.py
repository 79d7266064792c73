"""One robot's instance, by events."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from edge_samples import OTHER, STREAM, frame

from services.edge_worker.backlog import AHEAD
from services.edge_worker.checkpoint import Checkpoint
from services.edge_worker.instance import IN_FLIGHT, Instance
from services.edge_worker.instructions import Acknowledge, Feed, Fetch, Finish, Instruction, Keep, Open
from services.edge_worker.phase import Phase

WINDOW = 16


@pytest.fixture
def instance() -> Iterator[Instance]:
    made = Instance("r1", (1, 1), worker=0, window=WINDOW)
    yield made
    made.validate()


def running(instance: Instance, *, empty_spool: bool = True) -> Instance:
    instance.open()
    instance.opened()
    if empty_spool:
        instance.page_came(STREAM, [], 0, None)
    return instance


def late(instance: Instance) -> None:
    """It runs, and has found that no checkpoint has what the spool has forgotten."""
    running(instance, empty_spool=False)
    instance.page_came(STREAM, [frame(5), frame(6)], 5, None)
    instance.opened()


def fed(steps: list[Instruction]) -> list[int]:
    return [step.frame.seq for step in steps if isinstance(step, Feed)]


def fetched(steps: list[Instruction]) -> list[int]:
    return [step.start for step in steps if isinstance(step, Fetch)]


def test_an_opened_instance_asks_the_spool_for_the_first_frame(instance: Instance) -> None:
    assert instance.open() == [Open("r1", 1, 0, "")]
    assert instance.opened() == [Fetch("r1", 1, "", 0)]


def test_frames_are_fed_in_order_whatever_order_they_come_in(instance: Instance) -> None:
    running(instance)
    assert fed(instance.frame_came(frame(1))) == []
    assert fed(instance.frame_came(frame(2))) == []
    assert fed(instance.frame_came(frame(0))) == [0, 1, 2]


def test_a_frame_that_comes_twice_is_fed_once(instance: Instance) -> None:
    running(instance)
    assert fed(instance.frame_came(frame(0))) == [0]
    assert fed(instance.frame_came(frame(0))) == []
    instance.frame_done(0, failed=False)
    assert fed(instance.frame_came(frame(0))) == []


def test_no_more_is_in_flight_than_keeps_a_worker_busy(instance: Instance) -> None:
    running(instance)
    steps = [step for seq in range(IN_FLIGHT + 3) for step in instance.frame_came(frame(seq))]
    assert fed(steps) == list(range(IN_FLIGHT))
    assert fed(instance.frame_done(0, failed=False)) == [IN_FLIGHT]


def test_a_gap_is_backfilled_before_the_edge_goes_on(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.tick(0.0)
    assert fetched(instance.frame_came(frame(3))) == [1]
    assert fed(instance.page_came(STREAM, [frame(1), frame(2), frame(3)], 0, None)) == [1, 2, 3]


def test_a_long_spool_is_fetched_page_after_page_without_a_tick(instance: Instance) -> None:
    running(instance, empty_spool=False)
    steps = instance.page_came(STREAM, [frame(seq) for seq in range(40)], 0, 40)
    assert fed(steps) == list(range(IN_FLIGHT))
    asked = []
    for seq in range(40):
        asked += fetched(instance.frame_done(seq, failed=False))
    assert asked == [40]


def test_what_the_spool_no_longer_has_is_a_gap(instance: Instance) -> None:
    late(instance)
    assert fed(instance.page_came(STREAM, [frame(5), frame(6)], 5, None)) == [5, 6]
    assert instance.backlog.gaps == 5


def test_a_gap_is_passed_also_while_frames_before_it_are_in_flight(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.tick(0.0)
    instance.frame_came(frame(9))
    assert fed(instance.page_came(STREAM, [frame(7), frame(8), frame(9)], 7, None)) == [7, 8, 9]
    assert (instance.backlog.gaps, instance.processed) == (6, -1)


def test_a_frame_of_the_spool_that_cannot_be_read_is_a_gap(instance: Instance) -> None:
    running(instance, empty_spool=False)
    assert fed(instance.page_came(STREAM, [frame(0), frame(2)], 0, 4)) == [0, 2]
    assert instance.backlog.gaps == 2
    instance.page_came(STREAM, [frame(4)], 0, None)
    assert instance.backlog.next_seq == 5


def test_a_robot_that_does_not_answer_is_asked_again_at_the_next_tick(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.tick(0.0)
    assert fetched(instance.frame_came(frame(2))) == [1]
    assert instance.fetch_failed() == []
    assert fetched(instance.frame_came(frame(3))) == []
    assert fetched(instance.tick(0.0)) == [1]


def test_a_spool_that_has_nothing_yet_is_not_asked_in_a_circle(instance: Instance) -> None:
    running(instance)
    assert fetched(instance.frame_came(frame(1))) == []
    assert fetched(instance.tick(0.0)) == [0]
    assert fetched(instance.page_came(STREAM, [], 0, None)) == []
    assert fetched(instance.frame_came(frame(2))) == []
    assert fetched(instance.tick(0.0)) == [0]


def test_an_ended_stream_is_finished_once_all_of_it_is_taken(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    assert instance.stream_ended(STREAM, 0) == []
    kept = Keep("r1", 1, Checkpoint(STREAM, 0, gaps=0, skipped=0))
    assert instance.frame_done(0, failed=False) == [Acknowledge("r1", 1), kept, Finish("r1", 1)]
    assert instance.finished() == [Acknowledge("r1", 1)]
    assert instance.phase is Phase.FINAL


def test_the_lost_tail_of_an_ended_stream_is_fetched_at_once(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.tick(0.0)
    assert fetched(instance.stream_ended(STREAM, 2)) == [1]


def test_a_stream_that_ended_before_any_frame_makes_a_final_empty_map(instance: Instance) -> None:
    running(instance)
    assert Finish("r1", 1) in instance.stream_ended(STREAM, -1)
    instance.finished()
    assert (instance.phase, instance.processed) == (Phase.FINAL, -1)


def test_a_frame_after_the_end_makes_the_end_untold(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.stream_ended(STREAM, 0)
    instance.frame_done(0, failed=False)
    instance.frame_came(frame(1))
    assert instance.finished() == [Open("r1", 2, 0, STREAM)]
    assert fed(instance.opened(Checkpoint(STREAM, 0, 0, 0))) == [1]
    instance.frame_done(1, failed=False)
    assert instance.phase is Phase.RUNNING
    assert instance.stream_ended(STREAM, 0) == []
    assert Finish("r1", 2) in instance.stream_ended(STREAM, 1)


def test_a_final_instance_that_hears_of_a_later_end_fetches_the_rest(instance: Instance) -> None:
    running(instance)
    instance.stream_ended(STREAM, -1)
    instance.finished()
    assert instance.stream_ended(STREAM, 3) == [Open("r1", 2, 0, STREAM)]
    assert fetched(instance.opened()) == [0]


def test_answers_of_frames_never_fed_change_nothing(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    assert instance.frame_done(3, failed=False) == []
    assert instance.processed == -1


def test_frames_of_another_stream_are_counted_and_not_fed(instance: Instance) -> None:
    running(instance)
    assert fed(instance.frame_came(frame(0, stream=OTHER))) == []
    assert instance.foreign == 1


def test_a_page_of_another_stream_tells_nothing(instance: Instance) -> None:
    running(instance)
    instance.tick(0.0)
    instance.frame_came(frame(2))
    instance.page_came(OTHER, [frame(0, stream=OTHER)], 7, None)
    assert (instance.backlog.next_seq, instance.backlog.gaps) == (0, 0)


def test_a_new_stream_starts_the_instance_again(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    assert instance.stream_changed(OTHER) == [Open("r1", 2, 0, OTHER)]
    instance.opened()
    assert fed(instance.frame_came(frame(0, stream=OTHER))) == [0]


def test_frames_far_ahead_are_dropped_counted_and_fetched_in_time(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(AHEAD))
    assert (instance.backlog.overrun, len(instance.backlog.waiting), instance.backlog.told) == (1, 0, AHEAD + 1)


def test_frames_of_unknown_kinds_are_skipped_and_count_as_processed(instance: Instance) -> None:
    running(instance)
    assert fed(instance.frame_came(frame(0, kind="smell"))) == []
    assert (instance.skipped, instance.processed) == (1, 0)


def test_a_frame_that_kills_twice_is_set_aside(instance: Instance) -> None:
    running(instance)
    for _ in range(2):
        instance.frame_came(frame(0))
        instance.worker_died(0, guilty=True)
        instance.opened()
    assert fed(instance.page_came(STREAM, [frame(0), frame(1)], 0, None)) == [1]
    assert instance.skipped == 1


def test_a_frame_during_which_another_killed_the_worker_is_not_blamed(instance: Instance) -> None:
    running(instance)
    for _ in range(3):
        instance.frame_came(frame(0))
        instance.worker_died(0, guilty=False)
        instance.opened()
    assert fed(instance.page_came(STREAM, [frame(0)], 0, None)) == [0]


def test_processed_never_passes_a_frame_in_flight(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.frame_came(frame(1, kind="smell"))
    assert instance.processed == -1
    instance.frame_done(0, failed=False)
    assert instance.processed == 1


def test_under_a_new_epoch_the_robot_is_told_again(instance: Instance) -> None:
    running(instance)
    instance.tick(0.0)
    assert Acknowledge("r1", 1) not in instance.tick(0.0)
    instance.rerouted((2, 1))
    assert Acknowledge("r1", 1) in instance.tick(0.0)
