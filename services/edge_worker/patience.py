"""When a worker process is stuck: what it spends on one call, not counting what it waits for a processor.

A call that computes for longer than the limit is stuck, and so is one that sleeps for longer. On a loaded machine, or
under a CPU limit, a worker does neither while others run, so a slow one is not taken for a stuck one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from common.telemetry import cpu_s, proc_fields


class Activity(NamedTuple):
    cpu_s: float
    """of all threads, since the process began"""
    sleeps: bool
    """its main thread waits for something other than a processor"""


def activity(pid: int) -> Activity | None:
    """What a process does just now; None when it is gone, or where there is no /proc."""
    fields = proc_fields(pid)
    return None if fields is None else Activity(cpu_s(fields), fields[0] == "S")


@dataclass
class Patience:
    """Ask it often: `stuck` is True once a call has spent more than `limit_s`."""

    limit_s: float
    call: int | None = None
    """the call being worked on"""
    spent_s: float = 0.0
    when: float = 0.0
    cpu_s: float = 0.0

    def stuck(self, call: int | None, seen: Activity, now: float) -> bool:
        """`call`: the number of the one being worked on, None when there is none; `now`: s of any clock."""
        if call != self.call or call is None:
            self.call, self.spent_s = call, 0.0
        else:
            computed = seen.cpu_s - self.cpu_s
            self.spent_s += now - self.when if seen.sleeps and computed == 0 else computed
        self.when, self.cpu_s = now, seen.cpu_s
        return self.spent_s > self.limit_s
