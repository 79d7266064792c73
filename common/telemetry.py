"""Logs in one format for all services, and what a process has used of its machine.

A line is `key=value` pairs or one JSON object; fields passed as `extra=` become keys of their own, so that one robot
or one frame can be followed through the logs of all tiers:

    log.warning("scan refused", extra={"robot": "r1", "reason": "no beams"})
"""

from __future__ import annotations

import json
import logging
import os
import resource
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

LogFormat = Literal["kv", "json"]

STANDARD_FIELDS = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
"""attributes that every log record has; all others came in by `extra=`"""


def setup_logging(service: str, format: LogFormat = "kv", level: int | str = logging.INFO) -> None:
    """Send all logs of this process to stderr, each line with the `service`'s name (`robot/r1`, `edge/e2`, ...)."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(Formatter(service, format))
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.captureWarnings(True)


class Formatter(logging.Formatter):
    """One line a record: time, level, service, message, then the record's own fields."""

    def __init__(self, service: str, format: LogFormat) -> None:
        super().__init__()
        self.service = service
        self.line = _json if format == "json" else _key_value

    def format(self, record: logging.LogRecord) -> str:
        fields: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "service": self.service,
            "message": record.getMessage(),
        }
        fields.update((name, value) for name, value in vars(record).items() if name not in STANDARD_FIELDS)
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return self.line(fields)


def _json(fields: dict[str, Any]) -> str:
    return json.dumps(fields, default=str)


def _key_value(fields: dict[str, Any]) -> str:
    traceback = fields.pop("traceback", None)
    line = " ".join(f"{name}={_quoted(value)}" for name, value in fields.items())
    return f"{line}\n{traceback}" if traceback else line


def _quoted(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    plain = text and text.isprintable() and not any(mark in text for mark in ' "=')
    return text if plain else json.dumps(text)


class ProcessStats(NamedTuple):
    cpu_s: float
    """user and system time since start, all threads"""
    rss_mb: float
    """memory resident now"""


def process_stats(children: Iterable[int] = ()) -> ProcessStats:
    """What this process and the `children` named by their pids have used; a child that is gone counts nothing."""
    own = _from_proc(os.getpid())
    if own is None:  # no /proc: the peak is the nearest thing to the present size
        usage = resource.getrusage(resource.RUSAGE_SELF)
        unit = 2**20 if sys.platform == "darwin" else 2**10
        own = ProcessStats(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 2**20)
    found = [own, *(stats for pid in children if (stats := _from_proc(pid)) is not None)]
    return ProcessStats(sum(stats.cpu_s for stats in found), sum(stats.rss_mb for stats in found))


def _from_proc(pid: int) -> ProcessStats | None:
    fields = proc_fields(pid)
    if fields is None:
        return None
    return ProcessStats(cpu_s(fields), int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20)


def proc_fields(pid: int) -> list[str] | None:
    """What /proc/PID/stat says after the name, the state first; None when the process is gone, or without /proc."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()  # the name before ")" may hold spaces
    except OSError:
        return None


def cpu_s(fields: list[str]) -> float:
    """User and system time since start, all threads, by `proc_fields`."""
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
