"""The name of a robot that is one of several alike containers."""

from __future__ import annotations

import re
import socket

NUMBERED = re.compile(r"-(\d+)(\.|$)")


def replica_name() -> str:
    """`r3` for the third replica of a compose service, which the network's name service knows by its address.

    Where no name service tells, the host's name: unique, and the same after a restart.
    """
    host = socket.gethostname()
    try:
        name, _, _ = socket.gethostbyaddr(socket.gethostbyname(host))
    except OSError:
        return host
    number = NUMBERED.search(name)
    return f"r{number.group(1)}" if number else host
