"""How a version of the global map came about: the stages of Eqs. 1-3, and the path that determined the total.

All times are of the newest contribution: a frame's packing, its way to the edge and its SLAM; the last preparative
fusion and the fetching of robot maps for it; the fetching of edge maps and the last global fusion.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from common.wire import EdgeMapNotice, MapNotice, RobotStatus, StageTimes, Trace


def trace(
    edges: Iterable[str],
    edge_maps: Mapping[str, EdgeMapNotice],
    robot_maps: Mapping[str, MapNotice],
    statuses: Mapping[str, RobotStatus],
    transfers: Mapping[str, float],
    fuse_s: float,
) -> Trace:
    """The trace of a global map made of the maps of `edges`; `transfers` are the times to fetch them, s."""
    robots: dict[str, StageTimes] = {}
    per_edge: dict[str, StageTimes] = {}
    total = 0.0
    critical: tuple[str, ...] = ("cloud",)
    for edge in sorted(edges):
        notice = edge_maps[edge]
        slowest, slowest_s = "", 0.0
        for robot in sorted(notice.covers):
            robots[robot] = _robot(robot_maps.get(robot), statuses.get(robot))
            spent = robots[robot].pack + robots[robot].transfer + robots[robot].slam
            if spent >= slowest_s:
                slowest, slowest_s = robot, spent
        times = StageTimes(transfer=notice.transfer_s + transfers.get(edge, 0.0), fuse=notice.fuse_s)
        per_edge[edge] = times
        arrival = slowest_s + times.transfer + times.fuse
        if arrival >= total:
            total, critical = arrival, (slowest, edge, "cloud")
    return Trace(
        robots=robots,
        edges=per_edge,
        cloud=StageTimes(fuse=fuse_s),
        total_s=total + fuse_s,
        critical=tuple(name for name in critical if name),
    )


def _robot(notice: MapNotice | None, status: RobotStatus | None) -> StageTimes:
    """Times of one frame of the robot (Eq. 1)."""
    frames = notice.cover.seq + 1 if notice is not None else 0
    return StageTimes(
        pack=status.pack_s if status is not None else 0.0,
        transfer=notice.transfer_s if notice is not None else 0.0,
        slam=notice.slam_s / frames if notice is not None and frames else 0.0,
    )
