"""No orphans: a child holds the reading end of a pipe whose writing end only its parent has.

When the parent ends, even by kill -9, the kernel closes the pipe and the child reads its end.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from types import TracebackType

from common.errors import UsageError

PARENT_FD = "RECSLAM_PARENT_FD"
"""environment name under which a child finds the number of its reading end"""

EXIT_AFTER_S = 10.0
"""an orphan that has not stopped by itself after this time exits hard"""


class Leash:
    """The parent's side: `subprocess.Popen(..., pass_fds=leash.pass_fds, env=os.environ | leash.environment)`.

    One leash serves any number of children. Closing it tells them all to stop.
    """

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe()
        self.pass_fds = (self._reading,)
        self.environment = {PARENT_FD: str(self._reading)}

    def close(self) -> None:
        """Idempotent; children started after it stop at once."""
        if self._writing >= 0:
            os.close(self._writing)
            os.close(self._reading)
            self._writing = -1

    def __enter__(self) -> Leash:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def watch_parent(on_gone: Callable[[], None], exit_after_s: float = EXIT_AFTER_S) -> bool:
    """Call `on_gone` once the parent is gone, and end the process hard `exit_after_s` later.

    Returns False, and watches nothing, when no parent left a pipe. `on_gone` is called in a thread of its own, so
    that a busy event loop cannot hide the loss: pass `lambda: loop.call_soon_threadsafe(stop.set)`.
    Raises UsageError when the environment names no open pipe.
    """
    text = os.environ.pop(PARENT_FD, None)  # not for our own children: the number means nothing to them
    if text is None:
        return False
    try:
        pipe = int(text)
        os.set_inheritable(pipe, False)
    except (ValueError, OSError) as error:
        raise UsageError(
            f"{PARENT_FD}={text} is no open pipe ({error}); unset it when no parent process started this one"
        ) from error
    threading.Thread(target=_wait, args=(pipe, on_gone, exit_after_s), name="parent-watch", daemon=True).start()
    return True


def _wait(pipe: int, on_gone: Callable[[], None], exit_after_s: float) -> None:
    while os.read(pipe, 64):
        pass
    overdue = threading.Timer(exit_after_s, os._exit, args=(1,))
    overdue.daemon = True
    overdue.start()
    on_gone()
