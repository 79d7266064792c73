"""What plans rest on: measurements heard from robots, edges and cloud, as the arguments of the planning process.

A round is what happens between two fusions of an edge: `map_every_s` seconds, so many frames of each robot. Medians
over recent reports keep single slow ones out.
"""

from __future__ import annotations

import itertools
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from common.config import Fleet
from common.wire import (
    CloudStatus,
    EdgeMapNotice,
    EdgeStatus,
    MapNotice,
    Message,
    RobotProfile,
    RobotStatus,
    Route,
    Transforms,
)
from common.wire.edge import VANISHED
from common.wire.limits import MAX_MESSAGE_BYTES
from services.scheduler.links import Links, as_stated
from services.scheduler.noise import Noise
from services.scheduler.profile import Profile
from services.scheduler.regression import FusionTimes

RECENT = 5
"""reports whose median counts: an edge that turns slow is seen after three"""
FRAME_HZ = 10.0
FRAME_BYTES = 1000.0
PACK_S = 1.0
"""no robot needs longer for a frame"""
NEVER_S = 1e6
"""price of moving the SLAM of a robot whose stream has ended: there is nothing to gain"""
SHOWN = 256
"""links in the status; all of them in a big fleet would be a message of their own"""
ALIKE = 1.25
"""edges whose speeds differ from what is expected of them by less than this factor are taken to be as expected"""
ALIKE_SCANS = 1.5
"""and robots of one sensor whose scans differ by less, as the sensor's median"""
SCAN_S = 0.005
"""of a scan where none has been timed"""


class Inputs:
    """Feed it every message with the time of its coming (s); ask it for the rows of robots and edges."""

    def __init__(self, fleet: Fleet, profile: Profile) -> None:
        self._fleet, self._profile = fleet, profile
        self._stated = {entry.id: entry.speed for entry in fleet.edges}
        self.notices: dict[tuple[str, str], MapNotice] = {}
        """(robot, edge) → newest"""
        self.world: Transforms | None = None
        self._profiles: dict[str, RobotProfile] = {}
        self._statuses: dict[str, RobotStatus] = {}
        self._sent: dict[str, deque[tuple[float, int]]] = defaultdict(lambda: deque(maxlen=16))
        self._sizes: dict[str, float] = {}
        """robot → mean bytes of the frames in its spool, when there last were any"""
        self._cores: dict[str, int] = {}
        self._recent: dict[tuple[str, str], deque[float]] = defaultdict(lambda: deque(maxlen=RECENT))
        self._scans: dict[tuple[str, str], float] = {}
        """(robot, edge) → seconds of a scan"""
        self._speeds: dict[str, float] = {}
        self._speeds_are_old = True
        self._usual: dict[str, float] = {}
        """sensor → usual seconds of a scan at speed 1; made with `_speeds`"""
        self._links = Links({entry.id: entry.bandwidth_mbps * 1e6 / 8 for entry in fleet.edges})
        self._fusions = FusionTimes(profile.fusion)
        self._noise = Noise()

    def hear(self, message: Message, now: float) -> None:
        match message:
            case RobotProfile():
                self._profiles[message.robot] = message
            case RobotStatus():
                self._robot_status(message, now)
            case EdgeStatus():
                self._edge_status(message)
            case MapNotice():
                self.notices[message.robot, message.edge] = message
                self._links.frames_delayed(message.robot, message.edge, message.transfer_s)
                self._noise.took("transfer", (message.robot, message.edge), message.transfer_s)
            case EdgeMapNotice():
                known = message.edge in self._speeds  # to measure anew at each map would cost maps x robots
                speed = self._speed_known(message.edge) if known else self.speed(message.edge)
                self._fusions.took(len(message.covers), message.area_m2, message.fuse_s * speed)
                self._noise.took("fuse", (message.edge, len(message.covers)), message.fuse_s)
            case CloudStatus():
                for link in message.links:
                    self._links.uplink_measured(link)
            case Transforms():
                self.world = message

    def _robot_status(self, status: RobotStatus, now: float) -> None:
        """What a robot says of itself counts only as far as it can be so: a wrong word must not bend others' plans."""
        if status.sent < 0:
            return
        self._statuses[status.robot] = status
        if not status.ended:
            self._sent[status.robot].append((now, status.sent))
        if status.spooled > 0 and 0 < status.spool_bytes <= status.spooled * MAX_MESSAGE_BYTES:
            self._sizes[status.robot] = status.spool_bytes / status.spooled

    def _edge_status(self, status: EdgeStatus) -> None:
        self._cores[status.edge] = max(1, status.cores)
        busy = [each for each in status.instances if each.state not in ("final", VANISHED)]
        at_once = min(len(busy), self.cores(status.edge))
        crowd = max(1.0, at_once / status.cores) if status.cores > 0 else 1.0  # a scan in one worker slows no other's
        for each in busy:
            if each.scan_ms > 0:
                recent = self._recent[each.robot, status.edge]
                recent.append(each.scan_ms / 1e3 / crowd)
                self._scans[each.robot, status.edge] = median(recent)
                self._noise.took("slam", (each.robot, status.edge), each.scan_ms)
                self._speeds_are_old = True
        for link in status.links:
            self._links.measured(status.edge, link)

    def cores(self, edge: str) -> int:
        """SLAM instances that run at once."""
        return self._fleet.edge.workers or self._cores.get(edge, 1)

    def speed(self, edge: str) -> float:
        """How much faster scans are there than the profile says or, without one, than the fleet's median is."""
        if self._speeds_are_old:
            self._speeds, self._speeds_are_old = self._measured_speeds(), False
        return self._speed_known(edge)

    def _speed_known(self, edge: str) -> float:
        """`speed` as it was when it was last asked for."""
        expected = as_stated(self._speeds, self._stated, edge, 1.0)
        off = self._speeds.get(edge, expected) / expected
        return expected * (off / ALIKE if off > ALIKE else off * ALIKE if off < 1 / ALIKE else 1.0)

    def _measured_speeds(self) -> dict[str, float]:
        alike: dict[str, list[float]] = defaultdict(list)
        for (robot, _), seconds in self._scans.items():
            alike[self._sensor(robot)].append(seconds)
        usual = {sensor: median(seconds) for sensor, seconds in alike.items()}
        found: dict[str, list[float]] = defaultdict(list)
        for (robot, edge), seconds in self._scans.items():
            reference = self._profile.scan_s(self._sensor(robot)) or usual[self._sensor(robot)]
            found[edge].append(reference / seconds)
        speeds = {edge: median(ratios) for edge, ratios in found.items()}
        alike.clear()
        for (robot, edge), seconds in self._scans.items():
            alike[self._sensor(robot)].append(seconds * speeds[edge])
        self._usual = {sensor: median(seconds) for sensor, seconds in alike.items()}
        return speeds

    def _sensor(self, robot: str) -> str:
        profile = self._profiles.get(robot)
        return profile.sensor if profile is not None else ""

    def sent(self, robot: str) -> int:
        """Frames that the robot has made, by its last report."""
        status = self._statuses.get(robot)
        return status.sent if status is not None else 0

    def frame_hz(self, robot: str) -> float:
        """Frames a second that the robot makes lately; one that is paced by its edge counts as an average one."""
        seen = self._sent.get(robot)
        if not self._fleet.robot.realtime or seen is None or seen[-1][0] <= seen[0][0] or seen[-1][1] <= seen[0][1]:
            return FRAME_HZ
        return (seen[-1][1] - seen[0][1]) / (seen[-1][0] - seen[0][0])

    def scan_s(self, robot: str, edge: str) -> float:
        """Seconds of a scan at speed 1, by what it takes where it runs."""
        seen, sensor, speed = self._scans.get((robot, edge)), self._sensor(robot), self.speed(edge)
        usual = self._usual.get(sensor) or self._profile.scan_s(sensor) or SCAN_S
        own = seen * speed if seen is not None else usual
        return usual if usual / ALIKE_SCANS < own < usual * ALIKE_SCANS else own

    def _again(self, status: RobotStatus) -> int:
        """Frames that another edge would have to take of the robot before it is where this one is, at most."""
        edge = self._fleet.edge
        return status.sent if edge.checkpoints is None else min(status.sent, edge.checkpoint_frames)

    def robot_rows(
        self, robots: Iterable[str], edges: Sequence[str], routes: Mapping[str, Route], reach: Mapping[str, list[str]]
    ) -> list[dict[str, Any]]:
        """One row a robot, as PlanHost.plan takes them; `reach` names the edges that each can reach."""
        rows = []
        for robot in robots:
            route, profile, status = routes[robot], self._profiles.get(robot), self._statuses.get(robot)
            ended = status is not None and status.ended
            frames = self.frame_hz(robot) * self._fleet.edge.map_every_s
            scan_s = self.scan_s(robot, route.slam_edge)
            size = self._sizes.get(robot, FRAME_BYTES)
            rows.append(
                {
                    "name": robot,
                    "reach": reach[robot] if len(reach[robot]) < len(edges) else None,
                    "start": profile.start if profile is not None else None,
                    "range_max": profile.range_max if profile is not None else 0.0,
                    "frame_bytes": size * frames,
                    "bandwidth": self._links.transfers(robot, edges, size * frames),
                    "slam_s": scan_s * frames,
                    "pack_s": min(max(status.pack_s, 0.0), PACK_S) if status is not None else 0.0,
                    "move_s": NEVER_S if ended else scan_s * self._again(status) if status is not None else 0.0,
                    "slam": route.slam_edge,
                    "fuse": route.fuse_edge,
                }
            )
        return rows

    def edge_rows(self, edges: Iterable[str], factor: Mapping[str, float] = {}) -> list[dict[str, Any]]:
        """One row an edge; `factor` on the speeds for what-if questions."""
        return [
            {
                "name": edge,
                "speed": self.speed(edge) * factor.get(edge, 1.0),
                "bandwidth": self._links.uplink(edge),
                "cores": self.cores(edge),
            }
            for edge in edges
        ]

    def fusion(self) -> list[float]:
        """Coefficients of the fusion model as it is now."""
        model = self._fusions.model
        return [model.map_s, model.pair_s, model.m2_s]

    def noise(self) -> dict[str, float]:
        """Standard deviation of a report of each stage's time, as a share of it."""
        return self._noise.shares()

    def figures(self, edges: Sequence[str]) -> dict[str, float]:
        """For the status."""
        return {
            **{f"speed {edge}": self.speed(edge) for edge in edges},
            **{f"uplink {edge} bytes/s": self._links.uplink(edge) for edge in edges},
            **dict(itertools.islice(self._links.figures(), SHOWN)),
            **dict(zip(("fusion s/map", "fusion s/pair", "fusion s/m2"), self.fusion(), strict=True)),
            **{f"noise of {stage}": share for stage, share in sorted(self.noise().items())},
            "fusions seen": float(len(self._fusions)),
        }
