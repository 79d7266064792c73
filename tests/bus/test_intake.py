from __future__ import annotations

import pytest
from probes import STREAM, frame, routes

from common.bus import keys
from common.bus.intake import MAX_SENDERS, PROBLEMS, Intake, contradiction, sender_of
from common.wire import Ack, Claims, Message, Refusal, RobotStatus, encode
from common.wire.limits import MAX_MESSAGE_BYTES


class Payload:
    def __init__(self, data: bytes, size: int | None = None) -> None:
        self.data, self.size = data, size
        self.copied = False

    def __len__(self) -> int:
        return len(self.data) if self.size is None else self.size

    def to_bytes(self) -> bytes:
        self.copied = True
        return self.data


def ack(robot: str, edge: str) -> Ack:
    return Ack(robot=robot, edge=edge, stream=STREAM, epoch=(1, 1), processed=0, durable=0, window=1)


STATUS = RobotStatus(
    robot="r1", stream=STREAM, sent=0, processed=0, spooled=0, spool_bytes=0, dropped=0, backfilled=0, edge="e7"
)


@pytest.mark.parametrize(
    ("key", "message", "word"),
    [
        (keys.robot_frames("r1"), frame("r1", 0), None),
        (keys.robot_frames("r1"), frame("r2", 0), "robot"),
        (keys.edge_ack("e1", "r1"), ack("r1", "e1"), None),
        (keys.edge_ack("e1", "r1"), ack("r2", "e1"), "robot"),
        (keys.edge_ack("e1", "r1"), ack("r1", "e2"), "edge"),
        (keys.robot_status("r1"), STATUS, None),  # its edge is no claim about the sender
        (keys.SCHEDULER_ROUTES, routes(1), None),
        ("elsewhere", ack("r1", "e1"), None),
        (keys.robot_status("r1"), Refusal(reason="who asks?"), None),
    ],
)
def test_the_sender_is_who_the_key_says(key: str, message: Message, word: str | None) -> None:
    fault = contradiction(key, message)
    assert (fault is None) if word is None else (fault is not None and f"speaks of {word}" in fault)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (keys.robot_status("r1"), Claims(edge="e1", claims={"r2": (9, 9)})),
        (keys.robot_status("r1"), routes(1)),
        (keys.robot_frames("r1"), ack("r1", "e1")),
        (keys.edge_status("e1"), STATUS),
        (keys.CLOUD_MAP, routes(1)),
    ],
)
def test_nobody_speaks_for_another_tier(key: str, message: Message) -> None:
    assert "is no word of the tier" in (contradiction(key, message) or "")


def test_a_good_message_is_received_and_counted() -> None:
    intake = Intake()
    data = encode(routes(3))
    received = intake.accept("scheduler/routes", Payload(data))
    assert received is not None
    assert (received.message, received.key, received.size) == (routes(3), "scheduler/routes", len(data))
    assert (intake.counters.received, intake.counters.received_bytes) == (1, len(data))
    assert not intake.problems


@pytest.mark.parametrize("data", [b"", b"garbage", b"\x93\x01\xa4Ackk\x80", encode(frame("r2", 0))])
def test_a_bad_message_is_counted_and_named_under_its_sender(data: bytes) -> None:
    intake = Intake()
    assert intake.accept(keys.robot_frames("r1"), Payload(data)) is None
    assert intake.counters.refused == {"robot/r1": 1}
    assert "robot/r1" in intake.problems[0]
    assert "robot/r1/frames" in intake.problems[0]
    assert intake.counters.flat()["refused"] == 1


def test_an_oversized_message_is_refused_before_it_is_copied() -> None:
    intake = Intake()
    payload = Payload(b"", MAX_MESSAGE_BYTES + 1)
    assert intake.accept("cloud/map", payload) is None
    assert not payload.copied
    assert "over the limit" in intake.problems[0]


def test_each_sender_is_logged_once_a_minute_and_counted_always(caplog: pytest.LogCaptureFixture) -> None:
    now = 0.0
    intake = Intake(clock=lambda: now)
    for now in (0.0, 1.0, 59.0):  # noqa: B007 read by the clock
        intake.accept(keys.robot_frames("r1"), Payload(b"x"))
        intake.accept(keys.robot_frames("r2"), Payload(b"x"))
    assert len(caplog.records) == 2
    now = 61.0
    intake.accept(keys.robot_frames("r1"), Payload(b"x"))
    assert len(caplog.records) == 3
    assert intake.counters.refused == {"robot/r1": 4, "robot/r2": 3}


def test_a_flood_of_invented_senders_is_contained() -> None:
    intake = Intake()
    for i in range(MAX_SENDERS + 100):
        intake.accept(f"robot/r{i}/frames", Payload(b"x"))
    assert len(intake.counters.refused) == MAX_SENDERS + 1
    assert intake.counters.refused["others"] == 100
    assert len(intake.problems) == PROBLEMS


def test_a_foreign_key_stands_for_its_sender() -> None:
    assert sender_of("a/b") == "a/b"
    assert len(sender_of("a/" * 500)) <= 64
    assert [sender_of(key) for key in ("cloud/map", "edge/e1/map")] == ["cloud", "edge/e1"]
