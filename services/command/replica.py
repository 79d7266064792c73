"""The name of a robot that is one of several alike containers.

Replicas carry no number of their own, but their network's name service knows each by its container's name
(`recslam-robot-3.recslam_default`). The system's resolver never asks it: the hosts file has the address already.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import struct
from pathlib import Path

NUMBERED = re.compile(r"-(\d+)(\.|$)")
RESOLVER = Path("/etc/resolv.conf")
PTR, INTERNET, RECURSE = 12, 1, 0x0100
TIMEOUT_S = 2.0
POINTER = 0xC0
"""first bits of a length byte that refers to labels elsewhere (RFC 1035, 4.1.4)"""


def replica_name() -> str:
    """`r3` for the third replica of a compose service.

    Where no name service tells, the host's name: unique, and the same after a restart.
    """
    host = socket.gethostname()
    try:
        number = NUMBERED.search(container_name(socket.gethostbyname(host), name_server()))
    except (OSError, IndexError, struct.error, UnicodeDecodeError):
        return host
    return f"r{number.group(1)}" if number else host


def name_server() -> str:
    """Address of the first one that the system knows. Raises OSError when there is none."""
    for line in RESOLVER.read_text().splitlines():
        words = line.split()
        if len(words) > 1 and words[0] == "nameserver":
            return words[1]
    raise OSError(f"{RESOLVER} names no name server")


def container_name(address: str, server: str, port: int = 53) -> str:
    """The name that a name server has for an IPv4 address; empty when none. Raises OSError when it does not answer."""
    reverse = ipaddress.ip_address(address).reverse_pointer
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(TIMEOUT_S)
        asking.sendto(question(reverse), (server, port))
        return answered_name(asking.recv(1500))


def question(name: str) -> bytes:
    """A request for the PTR record of a name (RFC 1035, 4.1)."""
    labels = b"".join(bytes([len(label)]) + label.encode() for label in name.split("."))
    return struct.pack(">6H", 1, RECURSE, 1, 0, 0, 0) + labels + b"\0" + struct.pack(">2H", PTR, INTERNET)


def answered_name(packet: bytes) -> str:
    """The name in the first PTR record of an answer, empty when there is none."""
    _, _, questions, answers, _, _ = struct.unpack_from(">6H", packet)
    at = 12
    for _ in range(questions):
        at = _labels(packet, at)[1] + 4
    for _ in range(answers):
        at = _labels(packet, at)[1]
        kind, _, _, length = struct.unpack_from(">HHIH", packet, at)
        at += 10
        if kind == PTR:
            return ".".join(_labels(packet, at)[0])
        at += length
    return ""


def _labels(packet: bytes, at: int) -> tuple[list[str], int]:
    """The labels of the name at a place of the packet, and where what follows it begins."""
    labels: list[str] = []
    after: int | None = None
    while (length := packet[at]) != 0:
        if length >= POINTER:
            after = at + 2 if after is None else after
            target = (length - POINTER) << 8 | packet[at + 1]
            if target >= at:
                raise IndexError("a name that refers to itself")
            at = target
            continue
        labels.append(packet[at + 1 : at + 1 + length].decode("ascii"))
        at += 1 + length
    return labels, at + 1 if after is None else after
