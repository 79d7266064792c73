"""What the scheduler decides: who is there, where each robot's frames and map go, and when a plan is due.

A robot is placed at the tick after it and its profile have come, by load: a fleet that comes at once is one table, not
one each. Plans regroup robots at intervals, and an edge that cannot keep up loses robots whatever is planned. A robot
that has left keeps its route: its map stays in the fused maps, and at the edge that has made it. An edge that is gone
for longer than the grace time loses its robots to the others, which make their maps from checkpoints and spools. When
the router is lost, nobody is declared gone: everybody seems to be. Every table has an epoch (term, n), the term being
the time at which the scheduler began, in seconds, and higher than that of any claim that is heard, so that the tables
of an earlier scheduler are fenced off. Events in, instructions out; times come with the events.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from common.presence import Linked, Presence, RobotSeen, RouterLink, seen
from common.wire import Claims, Epoch, RobotProfile, Route, Routes
from services.scheduler.events import (
    Claimed,
    EdgeSeen,
    Event,
    Instruction,
    Interval,
    MakePlan,
    PlanFailed,
    Planned,
    Profiled,
    Publish,
    Relieved,
    Tick,
)
from services.scheduler.topology import Topology

SETTLE_S = 10.0
"""once an edge is there, how long the first placing waits for the others that the fleet file names"""
REST_S = 120.0
"""for which no plan brings SLAM to an edge that could not keep up"""
SAID = 32
"""changes that the reason for a table names"""


@dataclass
class SchedulerState:
    topology: Topology
    expected_edges: tuple[str, ...]
    grace_s: float
    term: int = 1
    count: int = 0
    robots: dict[str, Presence] = field(default_factory=dict)
    edges: dict[str, Presence] = field(default_factory=dict)
    profiles: dict[str, RobotProfile] = field(default_factory=dict)
    routes: dict[str, Route] = field(default_factory=dict)
    link: RouterLink = field(default_factory=RouterLink)
    planning: bool = False
    moved: int = 0
    wished: dict[str, tuple[str, str]] = field(default_factory=dict)
    """robot → SLAM and fusing edge that the last plan would change to; done when the next one says so again"""
    relieved: dict[str, float] = field(default_factory=dict)
    """edge → when it last could not keep up"""
    stranded: set[str] = field(default_factory=set)
    """robots that reach no edge that is there"""
    counters: Counter[str] = field(default_factory=Counter)

    @property
    def epoch(self) -> Epoch:
        return self.term, self.count

    def handle(self, event: Event) -> list[Instruction]:
        match event:
            case RobotSeen(robot, alive, now):
                seen(self.robots, robot, alive, now)
            case EdgeSeen(edge, alive, now):
                seen(self.edges, edge, alive, now)
            case Profiled(profile):
                self.profiles[profile.robot] = profile
            case Linked(up, now):
                self.link.changed(up, now)
            case Claimed(claims, now):
                return self._claimed(claims, now)
            case Planned():
                return self._planned(event)
            case Relieved():
                return self._relieved(event)
            case PlanFailed():
                self.planning = False
                self.counters["plans failed"] += 1
            case Tick(now):
                return self._place(now)
            case Interval(now):
                return self._ask_for_plan(now)
        return []

    def usable_edges(self, now: float) -> list[str]:
        """Edges that are there, or whose absence is too fresh (or too widespread) to act on."""
        return sorted(edge for edge, presence in self.edges.items() if not self._is_gone(presence, now))

    def alive_edges(self) -> list[str]:
        return sorted(edge for edge, presence in self.edges.items() if presence.alive)

    def reachable(self, robot: str, edges: list[str]) -> list[str]:
        """Those of the edges that the robot can reach; none before its profile tells."""
        profile = self.profiles.get(robot)
        return [edge for edge in edges if profile is not None and (profile.edges is None or edge in profile.edges)]

    def rested_edges(self, now: float) -> list[str]:
        """Edges that are there and have kept up lately."""
        return [edge for edge in self.alive_edges() if now - self.relieved.get(edge, -REST_S) >= REST_S]

    def load(self) -> Counter[str]:
        """How many present robots each edge runs."""
        return Counter(
            route.slam_edge for robot, route in self.routes.items() if robot in self.robots and self.robots[robot].alive
        )

    def validate(self) -> None:
        """Raises AssertionError when an invariant does not hold."""
        for robot, route in self.routes.items():
            assert route.epoch <= self.epoch, f"{robot} has a route of the future"
            assert {route.slam_edge, route.fuse_edge} <= set(self.edges), f"{robot} is routed to an edge unheard of"

    def _steady(self, now: float) -> bool:
        """The router has been there for the grace time: who is there has shown it."""
        return self.link.up_for(now) > self.grace_s

    def _is_gone(self, edge: Presence, now: float) -> bool:
        """Gone for longer than the grace time, in which the router was there all along."""
        return self.link.missed_for(edge, now) > self.grace_s

    def _stays(self, robot: str) -> bool:
        """A robot that is not there keeps its SLAM edge: nobody else could make its map."""
        presence = self.robots.get(robot)
        return presence is None or not presence.alive

    def _settled(self, now: float) -> bool:
        first = min((presence.since for presence in self.edges.values()), default=now)
        return bool(self.routes) or now - first > SETTLE_S or all(edge in self.edges for edge in self.expected_edges)

    def _place(self, now: float) -> list[Instruction]:
        """Give a route to every present robot that has none, or whose edge is gone or out of its reach."""
        if not self.link.up or not self._settled(now):
            return []
        usable, alive, load = set(self.usable_edges(now)), self.alive_edges(), self.load()
        self.stranded = set()
        reasons = []
        for robot, presence in sorted(self.robots.items()):
            route = self.routes.get(robot)
            if robot not in self.profiles or (route is None and not presence.alive):
                continue  # where it reaches is not known
            if route is None or route.slam_edge not in usable or not self.reachable(robot, [route.slam_edge]):
                reasons += self._put(robot, route, alive, load)
            elif route.fuse_edge not in usable:
                self.routes[robot] = route.model_copy(update={"fuse_edge": route.slam_edge})
                reasons.append(f"{robot} fused at {route.slam_edge}: {route.fuse_edge} is gone")
        return self._publish(reasons) if reasons else []

    def _put(self, robot: str, old: Route | None, alive: list[str], load: Counter[str]) -> list[str]:
        choice = self.reachable(robot, alive)
        if not choice:
            self.stranded.add(robot)
            return []
        edge = self.topology.edge_for(robot, choice) or min(choice, key=lambda name: (load[name], name))
        self.routes[robot] = Route(slam_edge=edge, fuse_edge=edge, epoch=(self.term, self.count + 1))
        load[edge] += self.robots[robot].alive
        if old is None:
            return [f"{robot} came: to {edge}"]
        load[old.slam_edge] -= self.robots[robot].alive
        self.moved += 1
        return [f"{robot} moves to {edge}: {old.slam_edge} is gone or out of reach"]

    def _publish(self, news: list[str]) -> list[Instruction]:
        self.count += 1
        reason = "; ".join(news[:SAID]) + (f"; and {len(news) - SAID} more" if len(news) > SAID else "")
        return [Publish(Routes(epoch=self.epoch, routes=dict(sorted(self.routes.items()))), reason)]

    def _claimed(self, claims: tuple[Claims, ...], now: float) -> list[Instruction]:
        """Take over robots that edges run already, and be above any table that they have heard."""
        news = []
        for each in claims:
            self.edges.setdefault(each.edge, Presence(alive=False, since=now))
            for robot, epoch in sorted(each.claims.items()):
                route = self.routes.get(robot)
                if route is None or route.epoch < epoch:
                    self.routes[robot] = Route(slam_edge=each.edge, fuse_edge=each.edge, epoch=epoch)
                    news.append(f"{robot} runs at {each.edge}")
        heard = max([epoch for each in claims for epoch in (each.epoch, *each.claims.values())], default=(0, 0))
        if heard > self.epoch:
            self.term, self.count = max(self.term, heard[0] + 1), 0
            news.append(f"an earlier scheduler's table {heard} is known")
        return self._publish(news) if news and self.routes else []

    def _ask_for_plan(self, now: float) -> list[Instruction]:
        edges = self.alive_edges()
        robots = tuple(robot for robot in sorted(self.routes) if self.reachable(robot, edges))
        if self.planning or not self.topology.regroups or len(edges) < 2 or len(robots) < 2:
            return []
        if not self._steady(now) or edges != self.usable_edges(now):
            return []  # somebody is missed: it comes back, or is found gone
        self.planning = True
        return [MakePlan(self.epoch, robots, tuple(edges))]

    def _planned(self, plan: Planned) -> list[Instruction]:
        self.planning = False
        alive = self.alive_edges()
        if plan.epoch != self.epoch or not self._steady(plan.now) or not set(self._named(plan)) <= set(alive):
            self.counters["plans overtaken by events"] += 1
            return []
        before, self.wished = self.wished, {}
        rested = self.rested_edges(plan.now)
        moves = []
        for robot, fuse in sorted(plan.fuse.items()):
            old = self.routes[robot]
            slam = plan.slam.get(robot, old.slam_edge)
            slam = slam if slam in rested and not self._stays(robot) else old.slam_edge
            if (slam, fuse) == (old.slam_edge, old.fuse_edge):
                continue
            if slam not in self.reachable(robot, alive):
                self.counters["moves out of reach refused"] += 1
                continue
            if before.get(robot) != (slam, fuse):
                self.wished[robot] = slam, fuse  # measurements are noisy, and to regroup may blur overlaps for a while
                continue
            epoch = old.epoch if slam == old.slam_edge else (self.term, self.count + 1)
            self.routes[robot] = Route(slam_edge=slam, fuse_edge=fuse, epoch=epoch)
            self.moved += slam != old.slam_edge
            moves.append(f"{robot} fused at {fuse}" + (f", run at {slam}" if slam != old.slam_edge else ""))
        return self._publish(moves) if moves else []

    def _relieved(self, relief: Relieved) -> list[Instruction]:
        alive, moves = self.alive_edges(), []
        self.relieved[relief.edge] = relief.now
        for robot, edge in sorted(relief.moves.items()):
            if not self._steady(relief.now) or edge not in self.reachable(robot, alive) or self._stays(robot):
                continue
            route = Route(slam_edge=edge, fuse_edge=self.routes[robot].fuse_edge, epoch=(self.term, self.count + 1))
            self.routes[robot] = route
            self.wished.pop(robot, None)
            self.moved += 1
            moves.append(f"{robot} run at {edge}")
        if not moves:
            return []
        self.counters["edges relieved"] += 1
        return self._publish([relief.reason, *moves])

    def _named(self, plan: Planned) -> list[str]:
        return [*plan.slam.values(), *plan.fuse.values()]
