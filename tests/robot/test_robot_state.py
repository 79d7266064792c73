"""What a robot agent decides, event by event, without a clock, a network or a disk."""

from __future__ import annotations

import ast
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from common.wire import Ack
from services.robot_agent import state as module
from services.robot_agent.state import (
    BATCH,
    AckReceived,
    AgentState,
    AnnounceEnd,
    BackfillServed,
    Collect,
    Collected,
    Event,
    Finish,
    Linger,
    LingerOver,
    Phase,
    RouteChanged,
    SourceEnded,
    Started,
    Trim,
)

STREAM = "a" * 32


def agent(window: int = 8, can_wait: bool = True, **fields: object) -> AgentState:
    return AgentState(stream=STREAM, window=window, can_wait=can_wait, **fields)  # type: ignore[arg-type]


def ack(processed: int, durable: int = -1, **fields: object) -> AckReceived:
    values = {"robot": "r1", "edge": "e1", "stream": STREAM, "epoch": (1, 1), "window": 8, **fields}
    return AckReceived(Ack(processed=processed, durable=durable, **values))  # type: ignore[arg-type]


def test_a_source_that_can_wait_gets_no_farther_than_the_window() -> None:
    state = agent(window=3)
    assert state.handle(Started()) == [Collect(3)]
    assert state.handle(Collected(1)) == [Collect(1)]
    assert state.handle(Collected(2)) == []
    assert state.handle(ack(0, window=3)) == [Collect(1)]


def test_an_edge_may_close_and_widen_the_window() -> None:
    state = agent(window=8, last_seq=7)
    assert state.handle(ack(5, window=2)) == []
    assert state.handle(ack(5, window=100)) == [Collect(BATCH)]


def test_a_live_source_never_waits() -> None:
    state = agent(window=1, can_wait=False)
    assert state.handle(Started()) == [Collect(1)]
    for seq in range(50):
        assert state.handle(Collected(seq)) == [Collect(1)]


def test_one_request_is_outstanding_at_most() -> None:
    state = agent()
    assert state.handle(Started()) == [Collect(8)]
    assert state.handle(Started()) == []
    assert state.handle(ack(-1)) == []


def test_a_batch_of_refused_scans_only_asks_again() -> None:
    state = agent(window=4)
    state.handle(Started())
    assert state.handle(Collected(-1)) == [Collect(4)]


def test_what_is_durable_is_trimmed_once() -> None:
    state = agent(last_seq=7)
    assert Trim(4) in state.handle(ack(5, durable=4))
    assert not [i for i in state.handle(ack(6, durable=4)) if isinstance(i, Trim)]


def test_acks_of_another_stream_are_ignored_and_counted() -> None:
    state = agent(last_seq=7)
    assert state.handle(ack(5, durable=5, stream="b" * 32)) == []
    assert (state.foreign_acks, state.processed, state.durable) == (1, -1, -1)


def test_acks_of_an_older_epoch_are_ignored_and_counted() -> None:
    state = agent(last_seq=7)
    state.handle(ack(3, epoch=(2, 1)))
    assert state.handle(ack(7, durable=7, epoch=(1, 9))) == []
    assert (state.stale_acks, state.processed, state.edge) == (1, 3, "e1")


def test_a_route_fences_the_old_edge_off_before_the_new_one_has_spoken() -> None:
    state = agent(last_seq=7)
    state.handle(ack(5, durable=2))
    state.handle(RouteChanged("e2", (1, 2)))
    assert state.handle(ack(6, durable=6)) == []
    assert (state.stale_acks, state.edge) == (1, "e2")


def test_two_edges_cannot_ack_in_one_epoch() -> None:
    state = agent(last_seq=7)
    state.handle(ack(5))
    state.handle(ack(7, edge="e2"))
    assert (state.stale_acks, state.processed) == (1, 5)


def test_an_older_routing_table_changes_nothing() -> None:
    state = agent(last_seq=7)
    state.handle(ack(5, epoch=(1, 5)))
    state.handle(RouteChanged("e9", (1, 4)))
    assert state.edge == "e1"


def test_after_a_hand_over_nothing_is_forgotten_that_the_new_edge_lacks() -> None:
    state = agent(last_seq=99, window=50)
    state.handle(ack(99, durable=40, window=50))
    state.handle(Collected(99))
    instructions = state.handle(ack(39, durable=40, epoch=(1, 2), edge="e2", window=50))
    assert instructions == []  # the new edge has the checkpoint only: the source waits until it has caught up
    assert (state.processed, state.durable) == (39, 40)


def test_acks_of_frames_that_were_never_numbered_are_ignored_and_counted() -> None:
    state = agent(last_seq=7)
    assert state.handle(ack(8)) == []
    assert state.handle(ack(7, durable=8)) == []
    assert (state.false_acks, state.processed) == (2, -1)


def test_the_end_is_announced_once_and_the_robot_stays() -> None:
    state = agent(last_seq=7)
    assert state.handle(SourceEnded()) == [AnnounceEnd(7)]
    assert state.handle(SourceEnded()) == []
    assert state.handle(ack(7)) == []
    assert state.phase is Phase.SERVING


def test_a_robot_told_to_exit_lingers_until_nobody_asks_any_more() -> None:
    state = agent(last_seq=7, exit_when_processed=True)
    assert state.handle(SourceEnded()) == [AnnounceEnd(7)]
    assert state.handle(ack(7)) == [Linger(2)]
    assert state.handle(BackfillServed(3)) == [Linger(3)]
    assert state.handle(LingerOver(2)) == []
    assert state.handle(LingerOver(3)) == [Finish()]


def test_acks_that_only_repeat_themselves_do_not_hold_up_the_exit() -> None:
    state = agent(last_seq=7, exit_when_processed=True)
    state.handle(SourceEnded())
    (linger,) = state.handle(ack(7))
    assert state.handle(ack(7, durable=7)) == [Trim(7)]
    assert state.handle(LingerOver(linger.number)) == [Finish()]  # type: ignore[union-attr]


def test_a_new_edge_calls_the_exit_off() -> None:
    state = agent(last_seq=7, exit_when_processed=True)
    state.handle(SourceEnded())
    (linger,) = state.handle(ack(7))
    state.handle(ack(3, epoch=(1, 2), edge="e2"))
    assert state.handle(LingerOver(linger.number)) == []  # type: ignore[union-attr]


def test_an_empty_stream_ends_too() -> None:
    state = agent(exit_when_processed=True)
    assert state.handle(Started()) == [Collect(8)]
    assert state.handle(SourceEnded()) == [AnnounceEnd(-1), Linger(1)]
    assert state.handle(LingerOver(1)) == [Finish()]


def test_a_restarted_robot_waits_for_word_of_the_edge() -> None:
    state = agent(window=8, last_seq=200)
    assert state.handle(Started()) == []
    assert state.handle(ack(200)) == [Collect(8)]


events: st.SearchStrategy[Event] = st.one_of(
    st.just(Started()),
    st.just(SourceEnded()),
    st.builds(
        lambda processed, durable, epoch, edge, window: ack(
            processed, durable, epoch=(1, epoch), edge=edge, window=window
        ),
        st.integers(-2, 40),
        st.integers(-2, 40),
        st.integers(0, 3),
        st.sampled_from(["e1", "e2"]),
        st.integers(-1, 20),
    ),
    st.builds(lambda edge, n: RouteChanged(edge, (1, n)), st.sampled_from(["e1", "e2"]), st.integers(0, 3)),
    st.builds(BackfillServed, st.integers(0, 5)),
    st.builds(LingerOver, st.integers(0, 5)),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(events, max_size=40), st.booleans(), st.booleans(), st.data())
def test_no_order_of_events_breaks_an_invariant(
    sequence: list[Event], can_wait: bool, leave: bool, data: st.DataObject
) -> None:
    state = agent(window=5, can_wait=can_wait, exit_when_processed=leave)
    farthest = -1
    for event in sequence:
        if isinstance(event, SourceEnded) and not state.collecting:
            continue
        durable = state.durable
        instructions = state.handle(event)
        while instructions:
            state.validate()
            assert state.durable >= durable
            collect = next((i for i in instructions if isinstance(i, Collect)), None)
            if collect is None or not data.draw(st.booleans()):
                break
            if can_wait:
                assert state.last_seq + collect.limit <= state.processed + state.window
            farthest = state.last_seq + data.draw(st.integers(0, collect.limit))
            instructions = state.handle(Collected(farthest))
    assert state.last_seq == farthest


def test_the_state_machine_knows_no_clock_network_or_disk() -> None:
    tree = ast.parse(Path(module.__file__).read_text())
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
    }
    assert imported <= {"__future__", "dataclasses", "enum", "common"}
