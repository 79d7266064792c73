"""What a run was and how good it was: `report.json` for programs, `report.md` for people."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from common.config import Fleet
from common.wire import StageTimes, Trace
from services.command.accuracy import Accuracy
from services.command.collect import GlobalMap, Statuses

PACKAGES = ("recslam", "eclipse-zenoh", "numpy", "numba", "opencv-python-headless", "scipy")


def report(
    fleet: Fleet, result: GlobalMap, statuses: Statuses, accuracy: Accuracy | None, elapsed_s: float
) -> dict[str, Any]:
    """`elapsed_s` is the wall time from the fleet's start to this map."""
    spans = {name: float(track[-1, 0] - track[0, 0]) for name, track in result.trajectories.items() if len(track)}
    longest = max(spans.values(), default=0.0)
    return {
        "fleet": fleet.name,
        "topology": fleet.topology,
        "policy": fleet.scheduler.policy,
        "kernel": fleet.slam.kernel,
        "seed": fleet.seed,
        "final": result.notice.final,
        "elapsed_s": elapsed_s,
        "driven_s": spans,
        "realtime_factor": longest / elapsed_s if elapsed_s > 0 else None,
        "map": _map(result),
        "components": [list(component.robots) for component in result.notice.components],
        "verdicts": [verdict.model_dump(mode="json") for verdict in statuses.verdicts],
        "unplaced": sorted({entry.id for entry in fleet.robots} - set(result.transforms.robots)),
        "completion": _completion(result.notice.trace),
        "bytes": _bytes(statuses),
        "frames": {name: status.sent for name, status in statuses.robots.items()},
        "vanished": statuses.vanished,
        "lost_frames": {name: status.dropped for name, status in statuses.robots.items() if status.dropped},
        "plan": statuses.plan.model_dump(mode="json") if statuses.plan is not None else None,
        "accuracy": accuracy.plain() if accuracy is not None else None,
        "versions": versions(),
        "machine": machine(),
    }


def write_report(data: Mapping[str, Any], folder: Path) -> None:
    (folder / "report.json").write_text(json.dumps(data, indent=2) + "\n")
    (folder / "report.md").write_text(markdown(data))


def summary(data: Mapping[str, Any]) -> list[str]:
    """The few lines that a command ends with."""
    parts = data["components"]
    lines = [f"map        {data['map']['known_m2']:.0f} m2 known, {_components(parts)}"]
    if data["unplaced"]:
        lines.append(f"unplaced   {', '.join(data['unplaced'])}")
    if data["vanished"]:
        last = ", ".join(f"{robot} at frame {frame}" for robot, frame in data["vanished"].items())
        lines.append(f"vanished   {last}: the map has what had come of it by then")
    if data["accuracy"]:
        found = data["accuracy"]
        lines.append(
            f"accuracy   IoU {found['iou']:.3f} (precision {found['precision']:.3f}, recall {found['recall']:.3f}), "
            f"coverage {found['coverage']:.3f}, walls {found['wall_thickness_cells']:.2f} cells thick, "
            f"ATE {found['ate_m']['all'] * 100:.1f} cm"
        )
    factor = data["realtime_factor"]
    speed = f", {factor:.1f} x real time" if factor else ""
    lines.append(f"time       {data['elapsed_s']:.1f} s{speed}; t_c {data['completion']['t_c_s']:.2f} s")
    return lines


def markdown(data: Mapping[str, Any]) -> str:
    completion, found = data["completion"], data["accuracy"]
    lines = [
        f"# {data['fleet']}: {data['topology']}, policy {data['policy']}, kernel {data['kernel']}",
        "",
        *(f"- {line.split(maxsplit=1)[0]}: {line.split(maxsplit=1)[1]}" for line in summary(data)),
        f"- {'final' if data['final'] else 'not final'}, map digest `{data['map']['digest'][:16]}`",
        "",
        f"## Completion time t_c = {completion['t_c_s']:.3f} s",
        "",
        f"Critical path: {' → '.join(completion['critical']) or 'unknown'}",
        "",
        "| who | pack s | transfer s | SLAM s | fuse s |",
        "|---|---|---|---|---|",
        *(_stage_row(name, times) for name, times in completion["stages"].items()),
        "",
        "## Bytes",
        "",
        "| stage | bytes |",
        "|---|---|",
        *(f"| {stage} | {count} |" for stage, count in data["bytes"].items()),
        "",
    ]
    if found:
        lines += [
            "## Accuracy against the simulated truth",
            "",
            "| robot | ATE m |",
            "|---|---|",
            *(f"| {name} | {error:.4f} |" for name, error in found["ate_m"].items()),
            "",
        ]
    if data["verdicts"]:
        lines += [
            "## Verdicts on pairs of robot maps",
            "",
            "| pair | verdict | overlap | agreement | conflict | runner-up | reason |",
            "|---|---|---|---|---|---|---|",
            *(_verdict_row(verdict) for verdict in data["verdicts"]),
            "",
        ]
    host = ", ".join(f"{name} {value}" for name, value in data["machine"].items())
    used = ", ".join(f"{name} {value}" for name, value in data["versions"].items())
    return "\n".join([*lines, f"Machine: {host}. Versions: {used}.", ""])


def versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def machine() -> dict[str, str | int]:
    return {
        "system": f"{platform.system()} {platform.release()}",
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
    }


def _map(result: GlobalMap) -> dict[str, Any]:
    occupancy, _ = result.grid.occupancy()
    return {
        "version": result.notice.version,
        "digest": result.notice.digest,
        "resolution_m": result.grid.resolution,
        "known_m2": float((occupancy >= 0).sum()) * result.grid.resolution**2,
        "occupied_cells": int((occupancy > 0).sum()),
    }


def _completion(trace: Trace) -> dict[str, Any]:
    stages: dict[str, StageTimes] = {
        **{f"robot {name}": times for name, times in sorted(trace.robots.items())},
        **{f"edge {name}": times for name, times in sorted(trace.edges.items())},
        "cloud": trace.cloud,
    }
    return {
        "t_c_s": trace.total_s,
        "critical": list(trace.critical),
        "stages": {name: times.model_dump() for name, times in stages.items()},
    }


def _bytes(statuses: Statuses) -> dict[str, int]:
    return {
        "robots to edges": sum(status.bytes_sent for status in statuses.robots.values()),
        "into edges": sum(status.bytes_in for status in statuses.edges.values()),
        "out of edges": sum(status.bytes_out for status in statuses.edges.values()),
        "into the cloud": statuses.cloud.bytes_in if statuses.cloud is not None else 0,
    }


def _components(components: list[list[str]]) -> str:
    names = "; ".join(", ".join(component) for component in components)
    return f"{len(components)} component{'' if len(components) == 1 else 's'} ({names})"


def _stage_row(name: str, times: Mapping[str, float]) -> str:
    cells = (f"{times[stage]:.4f}" if times[stage] else "" for stage in ("pack", "transfer", "slam", "fuse"))
    return f"| {name} | {' | '.join(cells)} |"


def _verdict_row(verdict: Mapping[str, Any]) -> str:
    shares = " | ".join(f"{verdict[name]:.3f}" for name in ("overlap", "agreement", "conflict", "runner_up"))
    return f"| {verdict['a']}, {verdict['b']} | {verdict['kind']} | {shares} | {verdict['reason']} |"
