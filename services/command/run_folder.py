"""The folder of one run: its configuration, logs, results, and, while it runs, where its router listens."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from common.errors import BadFile, UsageError

RUNS = Path("runs")
LATEST = RUNS / "latest"
CLUSTER = "cluster.json"


@dataclass(frozen=True)
class Cluster:
    """Where a running cluster is found."""

    endpoint: str
    root: str
    name: str
    pid: int
    started: float
    """seconds since 1970"""


class RunFolder:
    """`runs/<time>` or the folder asked for; `runs/latest` leads to the one made last."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.logs = self.path / "logs"
        self.spool = self.path / "spool"
        self.config = self.path / "fleet.toml"
        self.cluster = self.path / CLUSTER

    @classmethod
    def make(cls, out: Path | None) -> RunFolder:
        """Raises UsageError when the folder cannot be made or another run is going on in it."""
        try:
            folder = cls(out if out is not None else _new())
            folder.logs.mkdir(parents=True, exist_ok=True)
            if folder.cluster.exists() and _alive(read_cluster(folder.cluster).pid):
                raise UsageError(f"{folder.path}: a cluster is running there; choose another --out")
            _link(folder.path)
        except OSError as error:
            raise UsageError(f"cannot make the folder of the run: {error}") from error
        return folder

    @property
    def spooled(self) -> bool:
        """There are frames of an earlier run, which was broken off or recorded."""
        return any(self.spool.glob("*.spool"))

    def log(self, program: str) -> Path:
        return self.logs / f"{program.replace('/', '-')}.log"

    def announce(self, cluster: Cluster) -> None:
        """Let other commands find the cluster, all or nothing."""
        part = self.cluster.with_suffix(".part")
        part.write_text(json.dumps(asdict(cluster), indent=2) + "\n")
        part.replace(self.cluster)

    def withdraw(self) -> None:
        self.cluster.unlink(missing_ok=True)


def read_cluster(path: Path) -> Cluster:
    """Raises BadFile when it is no such file."""
    try:
        return Cluster(**json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise BadFile(f"{path}: {error}; remove it, or name the router by --endpoint") from error


def _new() -> Path:
    """A folder that nobody else has, also when two runs start in one second."""
    RUNS.mkdir(exist_ok=True)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for number in range(1, 1000):
        path = RUNS / (stamp if number == 1 else f"{stamp}-{number}")
        with suppress(FileExistsError):
            path.mkdir()
            return path
    raise UsageError(f"{RUNS}: a thousand runs in one second")


def _link(path: Path) -> None:
    RUNS.mkdir(exist_ok=True)
    if LATEST.exists() and not LATEST.is_symlink():
        raise UsageError(f"{LATEST} is no link; remove it")
    part = RUNS / f".latest-{os.getpid()}"
    part.unlink(missing_ok=True)
    part.symlink_to(os.path.relpath(path, RUNS.resolve()))
    part.replace(LATEST)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
