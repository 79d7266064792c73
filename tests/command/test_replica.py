"""A robot's name out of its container's."""

from __future__ import annotations

import socket
import struct
import threading

import pytest

from services.command import replica
from services.command.replica import answered_name, container_name, question, replica_name

ADDRESS = "172.19.0.9"
REVERSE = "9.0.19.172.in-addr.arpa"


def answer(asked: bytes, name: str) -> bytes:
    """As Docker's name service answers: the name asked for is referred to, not repeated."""
    labels = b"".join(bytes([len(part)]) + part.encode() for part in name.split(".")) + b"\0"
    record = b"\xc0\x0c" + struct.pack(">HHIH", 12, 1, 600, len(labels)) + labels
    return asked[:2] + struct.pack(">5H", 0x8180, 1, 1, 0, 0) + asked[12:] + record


def test_the_question_is_that_of_the_standard() -> None:
    assert question("a.bc") == bytes.fromhex("000101000001000000000000016102626300000c0001")


def test_a_name_server_is_asked_for_the_containers_name() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))

        def serve() -> None:
            asked, asker = server.recvfrom(1500)
            server.sendto(answer(asked, "recslam-robot-3.recslam_default"), asker)

        thread = threading.Thread(target=serve)
        thread.start()
        assert container_name(ADDRESS, "127.0.0.1", server.getsockname()[1]) == "recslam-robot-3.recslam_default"
        thread.join()


def test_an_answer_without_a_name_is_empty() -> None:
    asked = question(REVERSE)
    assert answered_name(asked[:2] + struct.pack(">5H", 0x8183, 1, 0, 0, 0) + asked[12:]) == ""


def test_a_name_that_refers_to_itself_is_refused() -> None:
    with pytest.raises(IndexError):
        answered_name(struct.pack(">6H", 1, 0x8180, 1, 0, 0, 0) + b"\xc0\x0c")


@pytest.mark.parametrize(
    ("container", "robot"), [("recslam-robot-3.recslam_default", "r3"), ("other-robot-12", "r12"), ("alone", "host-7")]
)
def test_a_replica_is_named_by_its_number(container: str, robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "host-7")
    monkeypatch.setattr(socket, "gethostbyname", lambda host: ADDRESS)
    monkeypatch.setattr(replica, "name_server", lambda: "127.0.0.11")
    monkeypatch.setattr(replica, "container_name", lambda address, server: container)
    assert replica_name() == robot


def test_where_no_name_server_answers_the_host_gives_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> str:
        raise TimeoutError

    monkeypatch.setattr(replica, "container_name", fail)
    monkeypatch.setattr(socket, "gethostbyname", lambda host: ADDRESS)
    assert replica_name() == socket.gethostname()
