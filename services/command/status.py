"""Who is there and how it goes, read from public keys."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table

from common.bus import Bus, keys
from common.grid.versions import count_of
from common.wire import GlobalMapNotice
from common.wire.codec import plain
from services.command import collect
from services.command.collect import Statuses


async def status(bus: Bus) -> tuple[Statuses, GlobalMapNotice | None]:
    return await collect.statuses(bus), await collect.one(bus, keys.CLOUD_MAP, GlobalMapNotice)


def as_data(statuses: Statuses, notice: GlobalMapNotice | None) -> dict[str, Any]:
    """For programs: plain numbers, names and lists."""
    matrix = statuses.overlap
    return {
        "robots": {name: plain(value) for name, value in statuses.robots.items()},
        "edges": {name: plain(value) for name, value in statuses.edges.items()},
        "cloud": plain(statuses.cloud) if statuses.cloud else None,
        "scheduler": plain(statuses.scheduler) if statuses.scheduler else None,
        "routes": plain(statuses.routes) if statuses.routes else None,
        "plan": plain(statuses.plan) if statuses.plan else None,
        "overlap": {"robots": list(matrix.robots), "weights": matrix.weights.tolist()} if matrix else None,
        "map": plain(notice) if notice else None,
        "vanished": statuses.vanished,
    }


def as_tables(statuses: Statuses, notice: GlobalMapNotice | None) -> RenderableType:
    return Group(_robots(statuses), _edges(statuses), *_lines(statuses, notice))


def _robots(statuses: Statuses) -> Table:
    table = Table("robot", "SLAM at", "fused at", "sent", "processed", "spooled", "lost", "state", "source")
    routes = statuses.routes.routes if statuses.routes else {}
    for name, robot in statuses.robots.items():
        route = routes.get(name)
        table.add_row(
            name,
            route.slam_edge if route else "-",
            route.fuse_edge if route else "-",
            str(robot.sent),
            str(robot.processed + 1),
            str(robot.spooled),
            str(robot.dropped),
            "vanished" if name in statuses.vanished else "ended" if robot.ended else "driving",
            robot.source,
        )
    for name, frame in statuses.vanished.items():
        if name not in statuses.robots:
            route = routes[name]
            table.add_row(name, route.slam_edge, route.fuse_edge, "-", str(frame + 1), "-", "-", "vanished", "-")
    return table


def _edges(statuses: Statuses) -> Table:
    table = Table("edge", "robots", "fuses", "cores", "CPU s", "MB", "problems")
    for name, edge in statuses.edges.items():
        table.add_row(
            name,
            ", ".join(instance.robot for instance in edge.instances) or "-",
            ", ".join(edge.fusing) or "-",
            str(edge.cores),
            f"{edge.cpu_s:.1f}",
            f"{edge.rss_mb:.0f}",
            "; ".join(edge.problems) or "-",
        )
    return table


def _lines(statuses: Statuses, notice: GlobalMapNotice | None) -> list[str]:
    plan = statuses.plan
    lines = ["scheduler: not there"] if statuses.scheduler is None else []
    if plan is not None:
        groups = "; ".join(f"{edge}: {', '.join(robots) or 'nobody'}" for edge, robots in plan.groups.items())
        lines.append(f"plan {plan.epoch[0]}.{plan.epoch[1]} by policy {plan.policy}: {groups} ({plan.reason})")
    if notice is None:
        return [*lines, "map: none yet" if statuses.cloud else "cloud: not there"]
    parts = "; ".join(", ".join(component.robots) for component in notice.components)
    final = "final" if notice.final else "not final"
    return [*lines, f"map {count_of(notice.version)}, {final}, {len(notice.components)} component(s): {parts}"]
