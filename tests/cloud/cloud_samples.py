"""Notices, verdicts and worlds as a cloud hears them, and a cluster that carries out what it asks."""

from __future__ import annotations

import random
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from common.wire import (
    Cover,
    EdgeMapNotice,
    FixedPose,
    MapNotice,
    PairVerdict,
    Placed,
    Route,
    Routes,
    Transforms,
    Verdicts,
)
from common.wire.base import Covers, Epoch
from services.cloud_merger.events import (
    Compose,
    Composed,
    EdgeMapNoticed,
    Event,
    FetchFailed,
    FetchPart,
    FetchSketch,
    Forget,
    Instruction,
    MapNoticed,
    PartFetched,
    Routed,
    SketchFetched,
    Solve,
    Solved,
    Tick,
    VerdictsCame,
)
from services.cloud_merger.state import CloudState

STREAM = "a" * 32


def cover(seq: int, epoch: Epoch = (1, 1), **corrected: Any) -> Cover:
    return Cover(stream=STREAM, seq=seq, epoch=epoch, **corrected)


def routes(
    n: int, slam: dict[str, str], fuse: dict[str, str] | None = None, epochs: Mapping[str, int] = MappingProxyType({})
) -> Routes:
    fuse = fuse or slam
    made = {r: Route(slam_edge=e, fuse_edge=fuse[r], epoch=(1, epochs.get(r, 1))) for r, e in slam.items()}
    return Routes(epoch=(1, n), routes=made)


def map_notice(robot: str, edge: str, version: int, final: bool = False, epoch: Epoch = (1, 1)) -> MapNotice:
    return MapNotice(
        robot=robot, edge=edge, epoch=epoch, version=version, resolution=0.05, cover=cover(version, epoch), final=final
    )


def edge_notice(edge: str, version: int, world: int, covers: Covers, final: bool = False) -> EdgeMapNotice:
    return EdgeMapNotice(
        edge=edge, version=version, world_epoch=world, resolution=0.05, components=(), covers=covers, final=final
    )


def verdicts(edge: str, *pairs: tuple[str, str], versions: tuple[int, int] = (1, 1), final: bool = True) -> Verdicts:
    found = [PairVerdict(a=a, b=b, kind="no_overlap", versions=versions, final=final) for a, b in pairs]
    return Verdicts(owner=f"edge/{edge}", pairs=tuple(found))


def solved(step: Solve, versions: dict[str, int]) -> Transforms:
    pose = FixedPose(x_um=0, y_um=0, theta_nrad=0)
    epoch = max(step.above, step.previous.world_epoch if step.previous else 0) + 1
    placed = {r: Placed(transform=pose, component=r, version=versions[r]) for r in step.robots}
    return Transforms(world_epoch=epoch, final=step.final, resolution=0.05, robots=placed, components=())


class Cluster:
    """Edges, merging process and network around a cloud, in any order and with failures."""

    def __init__(self, seed: int, robots: tuple[str, ...], edges: tuple[str, ...]) -> None:
        self.random = random.Random(seed)
        self.robots, self.edges = robots, edges
        self.state = CloudState(expected=robots)
        self.pending: list[Instruction] = []
        self.table = 0
        self.slam = dict.fromkeys(robots, edges[0])
        self.fuse = dict.fromkeys(robots, edges[0])
        self.epochs = dict.fromkeys(robots, 1)
        self.maps: dict[str, MapNotice] = {}
        self.shown: dict[str, EdgeMapNotice] = {}
        self.sketches: dict[str, int] = {}
        self.composed: list[Compose] = []
        self.solves: list[Solve] = []
        self.count = 0

    def give(self, event: Event) -> None:
        self.pending += self.state.handle(event)
        self.state.validate()

    def route(self) -> None:
        self.table += 1
        self.give(Routed(routes(self.table, self.slam, self.fuse, self.epochs)))

    def move(self) -> None:
        robot = self.random.choice(self.robots)
        self.fuse[robot] = self.random.choice(self.edges)
        if self.random.random() < 0.4:
            self.slam[robot] = self.random.choice(self.edges)
            self.epochs[robot] = self.table + 1
            self.maps.pop(robot, None)
        self.route()

    def tell_map(self, robot: str, final: bool) -> None:
        self.count += 1
        epoch = (1, self.epochs[robot])
        self.maps[robot] = map_notice(robot, self.slam[robot], self.count, final, epoch)
        self.give(MapNoticed(self.maps[robot]))

    def fuse_edge(self, edge: str) -> None:
        """The edge fuses what it has and tells its verdicts and its map."""
        self.count += 1
        own = {r: self.maps[r] for r in self.robots if self.fuse[r] == edge and r in self.maps}
        members = [r for r in self.robots if self.fuse[r] == edge]
        names = sorted(own)
        pairs = [
            PairVerdict(
                a=a,
                b=b,
                kind="no_overlap",
                versions=(own[a].version, own[b].version),
                final=own[a].final and own[b].final,
            )
            for k, a in enumerate(names)
            for b in names[k + 1 :]
        ]
        self.give(VerdictsCame(edge, Verdicts(owner=f"edge/{edge}", pairs=tuple(pairs))))
        world = self.state.world
        final = world is not None and world.final and sorted(members) == names and all(m.final for m in own.values())
        covers = {r: m.cover for r, m in own.items()}
        self.shown[edge] = edge_notice(edge, self.count, world.world_epoch if world else 0, covers, final)
        self.give(EdgeMapNoticed(self.shown[edge]))

    def carry_out(self, fail: bool = False) -> None:
        if not self.pending:
            return
        match self.pending.pop(self.random.randrange(len(self.pending))):
            case FetchSketch(notice) as step:
                if not fail:
                    self.sketches[notice.robot] = notice.version
                self.give(FetchFailed(step) if fail else SketchFetched(step))
            case FetchPart(notice) as step:
                now = self.shown[notice.edge]
                came = PartFetched(step, now.version, now.world_epoch, now.covers, now.final)
                self.give(FetchFailed(step) if fail else came)
            case Solve() as step:
                self.solves.append(step)
                self.give(Solved(None if fail else solved(step, self.sketches)))
            case Compose() as step:
                if not fail:
                    self.composed.append(step)
                self.give(Composed(well=not fail))
            case Forget():
                pass

    def settle(self) -> None:
        self.route()
        for robot in self.robots:
            self.tell_map(robot, final=True)
        for _ in range(12):
            for edge in self.edges:
                self.fuse_edge(edge)
            self.give(Tick())
            while self.pending:
                self.carry_out()


def only(kind: type, steps: list[Instruction]) -> Instruction:
    (step,) = [step for step in steps if isinstance(step, kind)]
    return step


def sketched(state: CloudState, robot: str, edge: str, version: int, final: bool = False) -> list[Instruction]:
    steps = state.handle(MapNoticed(map_notice(robot, edge, version, final)))
    step = only(FetchSketch, steps if final else state.handle(Tick()))
    return state.handle(SketchFetched(step))


def settled(expected: tuple[str, ...] = ("r1", "r2")) -> tuple[CloudState, Solve]:
    """r1 and r2 run and fused at e1 and e2, all final; and the final solve."""
    state = CloudState(expected=expected)
    state.handle(Routed(routes(1, {"r1": "e1", "r2": "e2"})))
    sketched(state, "r1", "e1", 1, final=True)
    return state, only(Solve, sketched(state, "r2", "e2", 1, final=True))


def part(state: CloudState, edge: str, robot: str, version: int, final: bool = True) -> list[Instruction]:
    assert state.world is not None
    covers = {robot: cover(1)}
    notice = edge_notice(edge, version, state.world.world_epoch, covers, final)
    step = only(FetchPart, [*state.handle(EdgeMapNoticed(notice)), *state.handle(Tick())])
    return state.handle(PartFetched(step, version, notice.world_epoch, covers, final))
