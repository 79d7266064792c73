"""A cluster of messages alone: what the scheduler would hear, in virtual time, and its planner called in process."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from common.config import EdgeConfig, EdgeEntry, Fleet, RobotConfig, SchedulerConfig
from common.presence import RobotSeen
from common.wire import (
    Cover,
    EdgeMapNotice,
    EdgeStatus,
    InstanceStatus,
    LinkStatus,
    MapNotice,
    RobotProfile,
    RobotStatus,
)
from services.scheduler.costs import FusionModel
from services.scheduler.events import EdgeSeen, Event, Instruction, Interval, MakePlan, Planned, Profiled, Publish, Tick
from services.scheduler.inputs import Inputs
from services.scheduler.plan_host import PlanHost
from services.scheduler.profile import Profile
from services.scheduler.state import (
    SchedulerState,
)
from services.scheduler.topology import Topology

STREAM = "0" * 32
SCAN_S = 0.005
HZ = 10.0
PLACE_M = 12.0
"""between rooms; a start's sensor disc is 8 m"""


@dataclass
class SyntheticCluster:
    """`robots` stand in rooms of about five; `noise` is the sigma of each report's log-normal error."""

    robots: int
    edges: int
    policy: str = "recslam"
    budget_s: float = 0.02
    noise: float = 0.0
    seed: int = 0
    reach: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """robot → edges; absent: all"""
    slowed: dict[str, float] = field(default_factory=dict)
    """edge → how many times longer everything takes there"""
    cores: int = 8

    def __post_init__(self) -> None:
        self.edge_names = [f"e{number}" for number in range(self.edges)]
        self.robot_names = [f"r{number:04d}" for number in range(self.robots)]
        self.fleet = Fleet(
            edges=tuple(EdgeEntry(id=edge) for edge in self.edge_names),
            robot=RobotConfig(realtime=True),
            edge=EdgeConfig(workers=self.cores),
            scheduler=SchedulerConfig(policy=self.policy, budget_s=self.budget_s),
        )
        self.state = SchedulerState(Topology("recslam"), tuple(self.edge_names), 3.0)
        self.inputs = Inputs(self.fleet, Profile(slam_s={"lds01": SCAN_S}))
        self.host = PlanHost()
        self.now = 0.0
        self.tables: list[Publish] = []
        self.event_s: list[float] = []
        self.plan_s: list[float] = []
        self._rng = np.random.default_rng(self.seed)
        self._sent = dict.fromkeys(self.robot_names, 0)

    def start(self) -> None:
        """Everybody comes."""
        rooms = max(1, self.robots // 5)
        for edge in self.edge_names:
            self.feed(EdgeSeen(edge, True, self.now))
        for number, robot in enumerate(self.robot_names):
            at = (PLACE_M * (number % rooms), float(self._rng.uniform(0, 3)), 0.0)
            edges = self.reach.get(robot)
            profile = RobotProfile(robot=robot, stream=STREAM, sensor="lds01", range_max=3.5, start=at, edges=edges)
            self.inputs.hear(profile, self.now)
            self.feed(Profiled(profile, self.now))
            self.feed(RobotSeen(robot, True, self.now))
        self.feed(Tick(self.now))

    def run(self, seconds: float, interval_s: float = 3.0) -> None:
        """Reports come each second, plans at intervals."""
        for second in range(round(seconds)):
            self.now += 1.0
            self.report()
            self.feed(Tick(self.now))
            if second % round(interval_s) == 0:
                self.feed(Interval(self.now))

    def feed(self, event: Event) -> None:
        begin = time.perf_counter()
        steps = self.state.handle(event)
        self.event_s.append(time.perf_counter() - begin)
        for step in steps:
            self._carry_out(step)

    def _carry_out(self, step: Instruction) -> None:
        if isinstance(step, Publish):
            self.tables.append(step)
        elif isinstance(step, MakePlan):
            begin = time.perf_counter()
            made = self.plan(step)
            self.plan_s.append(time.perf_counter() - begin)
            self.feed(Planned(step.epoch, made["slam"], made["fuse"], self.now))

    def plan(self, step: MakePlan) -> dict[str, Any]:
        """As the service asks its planning process."""
        edges, state, config = list(step.edges), self.state, self.fleet.scheduler
        reach = {robot: state.reachable(robot, edges) for robot in step.robots}
        return self.host.plan(
            robots=self.inputs.robot_rows(step.robots, edges, state.routes, reach),
            edges=self.inputs.edge_rows(edges),
            transforms=None,
            policy=config.policy,
            budget_s=config.budget_s,
            kappa=config.kappa,
            tau=config.tau,
            hysteresis=config.hysteresis,
            fusion=self.inputs.fusion(),
            horizon=config.horizon_s / self.fleet.edge.map_every_s,
            noise=self.inputs.noise(),
        )

    def report(self) -> None:
        """One second's statuses and notices of everybody, as noisy as wanted."""
        running: dict[str, list[str]] = {edge: [] for edge in self.edge_names}
        fused: dict[str, list[str]] = {edge: [] for edge in self.edge_names}
        for robot, route in self.state.routes.items():
            running[route.slam_edge].append(robot)
            fused[route.fuse_edge].append(robot)
            self._sent[robot] += round(HZ)
            self._hear(_robot_status(robot, self._sent[robot]))
            self._hear(_notice(robot, route.slam_edge, self._sent[robot], self._off(0.02)))
        for edge in self.edge_names:
            slow = self.slowed.get(edge, 1.0)
            scans = {robot: 1e3 * self._off(SCAN_S) * slow for robot in running[edge]}
            self._hear(_edge_status(edge, scans, self.cores, self._off))
            if fused[edge]:
                seconds = float(FusionModel().seconds(len(fused[edge]), 100.0))
                self._hear(_edge_map(edge, fused[edge], self._off(seconds) * slow))

    def _hear(self, message: Any) -> None:
        begin = time.perf_counter()
        self.inputs.hear(message, self.now)
        self.event_s.append(time.perf_counter() - begin)

    def _off(self, value: float) -> float:
        return float(value * np.exp(self._rng.normal(0.0, self.noise)))


def _robot_status(robot: str, sent: int) -> RobotStatus:
    counts = {"spooled": sent, "spool_bytes": 800 * sent, "dropped": 0, "backfilled": 0}
    return RobotStatus(robot=robot, stream=STREAM, sent=sent, processed=sent - 1, pack_s=1e-3, **counts)


def _notice(robot: str, edge: str, sent: int, delay: float) -> MapNotice:
    cover = Cover(stream=STREAM, seq=sent - 1, epoch=(1, 1))
    return MapNotice(
        robot=robot,
        edge=edge,
        epoch=(1, 1),
        version=sent,
        resolution=0.05,
        cover=cover,
        final=False,
        transfer_s=delay,
    )


def _edge_status(edge: str, scan_ms: dict[str, float], cores: int, off: Callable[[float], float]) -> EdgeStatus:
    instances = tuple(
        InstanceStatus(robot=robot, state="running", processed=9, pending=0, worker=0, scan_ms=ms, gaps=0, skipped=0)
        for robot, ms in scan_ms.items()
    )
    links = tuple(LinkStatus(peer=f"robot/{robot}", bytes_per_s=off(5e6), delay_s=0.0, pages=9) for robot in scan_ms)
    empty: dict[str, Any] = {"fusing": (), "stages": {}, "counters": {}}
    return EdgeStatus(edge=edge, cores=cores, cpu_s=1, rss_mb=1, instances=instances, links=links, **empty)


def _edge_map(edge: str, robots: list[str], seconds: float) -> EdgeMapNotice:
    cover = Cover(stream=STREAM, seq=1, epoch=(1, 1))
    return EdgeMapNotice(
        edge=edge,
        version=1,
        world_epoch=0,
        resolution=0.05,
        components=(),
        covers=dict.fromkeys(robots, cover),
        final=False,
        fuse_s=seconds,
        area_m2=100.0,
    )
