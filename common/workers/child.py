"""The inside of a worker process: `python -m common.workers.child MODULE:CLASS FD`.

Requests `[id, method, arguments]` come over the socket FD as length-prefixed msgpack and are answered in order
with `[id, true, result]` or `[id, false, message]`. The class is made once; its public methods are what can be
called. While no request waits, its method `idle`, if it has one, is called for as long as it returns true: there it
does what can wait, a few milliseconds at a time. A thread watches the socket: when the parent is gone, even by kill -9,
the process ends at once, whatever it was computing.

With a third argument, msgpack in hexadecimal of what `warm` is to be called with, this is a template, and FD the socket
over which it is given one socket for each worker to be forked (see forking.py).
"""

from __future__ import annotations

import importlib
import os
import queue
import socket
import sys
import threading
import traceback
from typing import Any

import msgpack

from common.errors import RecslamError
from common.workers.forking import forked
from common.workers.framing import HEAD

REST_S = 0.0005
"""between two rounds of what can wait: a request that has come is read in that time"""


def main() -> None:
    target, fd, *template = sys.argv[1:]
    channel = socket.socket(fileno=int(fd))
    if template:
        host, channel = forked(lambda: _made(target), channel, msgpack.unpackb(bytes.fromhex(template[0])))
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(channel, requests), name="requests", daemon=True).start()
    if not template:
        host = _made(target)
    _send(channel, [0, True, os.getpid()])
    busy = True
    while True:
        try:
            request_id, method, arguments = requests.get(timeout=REST_S if busy else None)
        except queue.Empty:
            busy = _idle(host)
            continue
        _send(channel, [request_id, *_call(host, method, arguments)])
        busy = True


def _made(target: str) -> Any:
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)()


def _idle(host: object) -> bool:
    try:
        return hasattr(host, "idle") and bool(host.idle())
    except Exception:
        traceback.print_exc()
        return False


def _call(host: object, method: str, arguments: dict[str, Any]) -> tuple[bool, Any]:
    try:
        if method.startswith("_"):
            raise AttributeError(f"{method} is not to be called from outside")
        return True, getattr(host, method)(**arguments)
    except Exception as error:
        if not isinstance(error, RecslamError):  # those say all in their message
            traceback.print_exc()
        return False, f"{type(error).__name__}: {error}"


def _read(channel: socket.socket, requests: queue.SimpleQueue[Any]) -> None:
    try:
        while True:
            (size,) = HEAD.unpack(_exactly(channel, HEAD.size))
            requests.put(msgpack.unpackb(_exactly(channel, size), strict_map_key=False))
    except (EOFError, ConnectionError):
        os._exit(0)  # the parent is gone; reset rather than end of file when it had not read all that we sent
    except BaseException:
        traceback.print_exc()
        os._exit(1)  # a worker that cannot hear must not linger


def _exactly(channel: socket.socket, size: int) -> bytes:
    parts = bytearray()
    while len(parts) < size:
        part = channel.recv(min(size - len(parts), 1 << 20))
        if not part:
            raise EOFError
        parts += part
    return bytes(parts)


def _send(channel: socket.socket, reply: list[Any]) -> None:
    data = msgpack.packb(reply)
    try:
        channel.sendall(HEAD.pack(len(data)) + data)
    except ConnectionError:
        os._exit(0)  # the parent is gone


if __name__ == "__main__":
    main()
