"""When an instance's kernel is kept, and how the instance goes on from a checkpoint, by events."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from edge_samples import OTHER, STREAM, frame

from services.edge_worker.checkpoint import Checkpoint
from services.edge_worker.instance import Instance
from services.edge_worker.instructions import Acknowledge, Feed, Fetch, Instruction, Keep, Open

WINDOW = 16


@pytest.fixture
def instance() -> Iterator[Instance]:
    made = Instance("r1", (1, 1), worker=0, window=WINDOW)
    yield made
    made.validate()


def running(instance: Instance) -> Instance:
    instance.open()
    instance.opened()
    instance.page_came(STREAM, [], 0, None)
    return instance


def fed(steps: list[Instruction]) -> list[int]:
    return [step.frame.seq for step in steps if isinstance(step, Feed)]


def fetched(steps: list[Instruction]) -> list[int]:
    return [step.start for step in steps if isinstance(step, Fetch)]


def kept(steps: list[Instruction]) -> list[int]:
    return [step.checkpoint.seq for step in steps if isinstance(step, Keep)]


def test_a_kernel_is_kept_after_so_many_frames_once_all_it_was_fed_is_taken(instance: Instance) -> None:
    instance.keeping.frames = 2
    running(instance)
    for seq in range(3):
        instance.frame_came(frame(seq))
    instance.frame_done(0, failed=False)
    instance.frame_done(1, failed=True)
    instance.tick(0.5)
    assert fed(instance.frame_came(frame(3))) == []
    steps = instance.frame_done(2, failed=False)
    assert steps[:2] == [Keep("r1", 1, Checkpoint(STREAM, 2, gaps=0, skipped=1)), Feed("r1", 1, frame(3))]


def test_a_kernel_is_kept_after_so_many_seconds_if_there_is_anything_new(instance: Instance) -> None:
    running(instance)
    instance.tick(100.0)
    instance.frame_came(frame(0))
    instance.frame_done(0, failed=False)
    assert kept(instance.tick(159.0)) == []
    assert kept(instance.tick(160.0)) == [0]
    assert kept(instance.tick(300.0)) == []


def test_a_restored_instance_goes_on_behind_its_checkpoint_and_remembers_what_was_left_out(instance: Instance) -> None:
    instance.open()
    steps = instance.opened(Checkpoint(STREAM, 41, gaps=3, skipped=2), durable=True)
    assert fetched(steps) == [42]
    assert (instance.processed, instance.backlog.gaps, instance.skipped) == (41, 3, 2)
    assert instance.keeping.durable == 41


def test_what_is_kept_durably_is_told_to_the_robot_at_the_next_tick(instance: Instance) -> None:
    running(instance)
    instance.frame_came(frame(0))
    instance.frame_done(0, failed=False)
    instance.keeping.seconds = 0.0
    assert kept(instance.tick(1.0)) == [0]
    assert Acknowledge("r1", 1) not in instance.tick(1.5)
    instance.kept_durably(0)
    assert Acknowledge("r1", 1) in instance.tick(2.0)
    assert instance.keeping.durable == 0


def test_a_checkpoint_of_another_stream_is_not_gone_on_from(instance: Instance) -> None:
    instance.open()
    instance.stream_changed(OTHER)
    assert instance.opened(Checkpoint(STREAM, 7, 0, 0)) == [Open("r1", 2, 0, OTHER)]


def test_checkpoints_are_left_alone_after_two_deaths_while_opening(instance: Instance) -> None:
    instance.open()
    instance.worker_died(0, guilty=False)
    assert instance.worker_died(0, guilty=False) == [Open("r1", 3, 0, "", afresh=True)]
    instance.opened()
    assert instance.worker_died(0, guilty=False) == [Open("r1", 4, 0, "")]


def test_before_the_spools_beginning_is_passed_a_newer_checkpoint_is_looked_for_once(instance: Instance) -> None:
    instance.open()
    instance.opened(Checkpoint(STREAM, 1, 0, 0))
    assert instance.page_came(STREAM, [frame(5)], 5, None) == [Open("r1", 2, 0, STREAM)]
    assert fetched(instance.opened(Checkpoint(STREAM, 4, 0, 0))) == [5]
    instance.page_came(STREAM, [frame(5)], 5, None)
    assert (list(instance.in_flight), instance.backlog.gaps) == ([5], 0)


def test_a_checkpoint_is_looked_for_again_when_what_followed_the_last_one_was_lost_with_its_worker(
    instance: Instance,
) -> None:
    instance.open()
    instance.opened(Checkpoint(STREAM, 1, 0, 0), durable=True)
    instance.page_came(STREAM, [frame(5)], 5, None)
    instance.opened(Checkpoint(STREAM, 4, 0, 0), durable=True)
    instance.page_came(STREAM, [frame(5)], 5, None)
    instance.frame_done(5, failed=False)
    instance.worker_died(0, guilty=False)
    for _ in range(2):  # another robot's frames kill the worker meanwhile: checkpoints are left alone
        (step,) = instance.worker_died(0, guilty=False)
    assert isinstance(step, Open)
    assert step.afresh
    assert fetched(instance.opened()) == [0]
    (again,) = instance.page_came(STREAM, [frame(5)], 5, None)
    assert again == Open("r1", instance.life, 0, STREAM)
    assert fetched(instance.opened(Checkpoint(STREAM, 4, 0, 0), durable=True)) == [5]
