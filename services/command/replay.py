"""Recorded runs: made once, and replayed with every policy, kernel and topology."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from common.config import CarmenSource, EdgeEntry, Fleet, RecordingSource, RobotEntry
from common.errors import BadFile, UsageError
from services.command import fleets

FLEET_FILE = "fleet.toml"
CHUNK = 256
"""sweeps spooled in one go"""


def from_log(log: Path, robots: int, edges: int) -> Fleet:
    """A CARMEN log cut among robots `r1`, `r2`, ..., who do not know where they start. Raises BadFile."""
    from common.formats.carmen import CarmenLog

    if not log.is_file():
        raise BadFile(f"{log}: no such file; give a CARMEN log, or the folder of a recorded run")
    CarmenLog(log)  # refuses what is none, before anything is started
    path = log.resolve()
    entries = tuple(
        RobotEntry(id=f"r{part + 1}", source=CarmenSource(path=path, part=part, parts=robots)) for part in range(robots)
    )
    return fleets.revised(Fleet(), name=log.name.split(".")[0], robots=entries, edges=_edges(edges), batch=True)


def from_recording(folder: Path, robots: int | None, edges: int | None) -> tuple[Fleet, Fleet]:
    """The fleet that replays a recorded run, and the one that was recorded.

    Raises BadFile, and UsageError for another number of robots than have been recorded.
    """
    try:
        recorded = fleets.load_fleet(str(folder / FLEET_FILE))
    except UsageError as error:
        raise BadFile(f"{folder} is no recorded run (`recslam record` makes one): {error}") from error
    spools = {entry.id: (_spools(folder) / f"{entry.id}.spool").resolve() for entry in recorded.robots}
    missing = [str(path) for path in spools.values() if not path.is_file()]
    if missing:
        made = "`recslam record` makes them, or a run with robot.record = true"
        raise BadFile(f"{folder}: lacks the frames of its robots, {', '.join(missing)}; {made}")
    if robots not in (None, len(spools)):
        raise UsageError(f"--robots: {folder} is of {len(spools)} robots, and only a log is cut among others")
    entries = tuple(
        entry.model_copy(update={"source": RecordingSource(path=spools[entry.id]), "join_after_s": 0.0})
        for entry in recorded.robots
    )
    fleet = fleets.revised(recorded, robots=entries, batch=True, robot={"record": False, "realtime": False})
    return (fleet if edges is None else fleets.revised(fleet, edges=_edges(edges))), recorded


def record(fleet: Fleet, out: Path) -> dict[str, int]:
    """Spool all frames of a fleet of logs and simulated robots into `out`; robot → frames. Nothing else runs.

    Raises UsageError when a robot has no end, or `out` holds a recording or a part of one already.
    """
    if not fleet.robots:
        raise UsageError("robots: none; there is nothing to record")
    if (out / FLEET_FILE).exists():
        raise UsageError(f"{out}: holds a recorded run already; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    if any(out.glob("*.spool")):  # the robots would go on with it, whatever fleet it is of
        raise UsageError(f"{out}: holds a recording that was broken off; remove it, or choose another --out")
    names = [entry.id for entry in fleet.robots]
    workers = min(len(names), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        counts = list(pool.map(_record_robot, repeat(fleet), names, repeat(out)))
    fleets.write(fleet, out / FLEET_FILE)
    return dict(zip(names, counts, strict=True))


def _record_robot(fleet: Fleet, robot: str, out: Path) -> int:
    """Runs in a process of its own; returns the number of frames."""
    from services.robot_agent.app import spool_path
    from services.robot_agent.collector import Collector
    from services.robot_agent.sources.factory import make
    from services.robot_agent.spool import Spool

    source = make(fleet.robot_entry(robot), fleet)
    limit = int(fleet.robot.spool_mb * 2**20)
    with Spool(spool_path(out, robot), robot, limit, keep_durable=True) as spool:
        collector = Collector(source, spool, fleet.robot.lossless)
        while not collector.take(CHUNK).ended:
            pass
        kept = spool.now()
        if kept.dropped:
            raise UsageError(f"robot.spool_mb = {fleet.robot.spool_mb:g} is too small for {robot}: raise it")
        return kept.frames


def _edges(count: int) -> tuple[EdgeEntry, ...]:
    return tuple(EdgeEntry(id=f"edge-{number + 1}") for number in range(count))


def _spools(folder: Path) -> Path:
    """A recorded run has its spools in itself, the folder of a cluster's run in `spool`."""
    return folder / "spool" if (folder / "spool").is_dir() else folder
