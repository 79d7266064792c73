"""The inside of a template: it makes a class, calls its `warm`, and forks itself for each socket that it is given."""

from __future__ import annotations

import fcntl
import gc
import os
import select
import signal
import socket
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack

from common.errors import RecslamError
from common.workers.framing import HEAD


def forked(make: Callable[[], Any], control: socket.socket, warm: dict[str, Any]) -> tuple[Any, socket.socket]:
    """Returns in each forked worker, with its own copy of the class's one instance and its socket."""
    _end_with_parent(control, True)
    host = _warmed(make, control, warm)
    _end_with_parent(control, False)
    gc.collect()
    gc.freeze()  # what all share is not looked at again: that would write to it
    ended, ending = socket.socketpair()
    ending.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(ending.fileno())
    _tell(control, "ready")
    while True:
        ready, _, _ = select.select([control, ended], [], [])
        if ended in ready:
            ended.recv(4096)
            for pid, code in _gone():
                _tell(control, "ended", pid, code)
        if control not in ready:
            continue
        given = _given(control)
        try:
            pid = os.fork()
        except OSError as error:
            _tell(control, "not forked", detail=f"no worker could be forked: {error}")
        else:
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for each in (control, ended, ending):
                    each.close()
                return host, given
            _tell(control, "forked", pid)
        given.close()


def _warmed(make: Callable[[], Any], control: socket.socket, warm: dict[str, Any]) -> Any:
    """The instance; the process ends when it cannot be made, or has started threads, of which a fork has none."""
    try:
        host = make()
        host.warm(**warm)
        threads = sum(1 for _ in Path("/proc/self/task").glob("*"))
        if threads > 1:
            raise RuntimeError(f"{threads} threads run here")
    except Exception as error:
        if not isinstance(error, RecslamError):  # those say all in their message
            traceback.print_exc()
        _tell(control, "not ready", detail=f"{type(error).__name__}: {error}")
        os._exit(1)
    return host


def _end_with_parent(control: socket.socket, now: bool) -> None:
    """Let the kernel end this process when the parent's end of the socket closes, whatever it computes just then."""
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(control, fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(control, fcntl.F_GETFL)
    fcntl.fcntl(control, fcntl.F_SETFL, flags | os.O_ASYNC if now else flags & ~os.O_ASYNC)


def _given(control: socket.socket) -> socket.socket:
    """The next worker's socket."""
    try:
        data, descriptors, _, _ = socket.recv_fds(control, 1, 1)
    except ConnectionError:
        data = b""
    if not data:
        os._exit(0)  # the parent is gone
    return socket.socket(fileno=descriptors[0])


def _gone() -> Iterator[tuple[int, int]]:
    """Process id and exit code of each worker that has ended since the last look."""
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        yield pid, os.waitstatus_to_exitcode(status)


def _tell(control: socket.socket, what: str, pid: int = 0, detail: Any = None) -> None:
    data = msgpack.packb([what, pid, detail])
    try:
        control.sendall(HEAD.pack(len(data)) + data)
    except ConnectionError:
        os._exit(0)  # the parent is gone
