"""What runs inside an edge's fusion process: preparative fusion of the robot maps held there.

Pairs are decided, transforms solved, and each robot map is rendered once, from its own frame straight onto the
lattice of the world (or of the edge, before the cloud has placed it); the edge map is the sum.
"""

from __future__ import annotations

import secrets
import time
from typing import Any

from common.errors import UsageError
from common.fusion.layout import bounds, lay_out
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, all_pairs, component, places
from common.fusion.settings import FusionSettings
from common.fusion.solve import Solved, solve
from common.fusion.verdicts import measurements
from common.geometry.se2 import compose
from common.grid import Grid
from common.grid.compose import cap_votes, compose_into
from common.grid.paging import counts_page
from common.grid.render import render
from common.grid.tiles import decode_counts
from common.grid.versions import first_version
from common.wire import FixedPose, Transforms, Verdicts, Warp, decode, encode

VOTES = 255
"""visits of a cell that count of one robot"""

Place = tuple[FixedPose, Warp | None]
"""where a robot map is rendered, and what straightens it before"""


class FusionHost:
    """Called through common.workers; arguments and results are plain msgpack values."""

    def __init__(self) -> None:
        self._pairs = PairTable()
        self._maps: dict[str, Grid] = {}
        self._covers: dict[str, dict[str, Any]] = {}
        self._rendered: dict[str, tuple[tuple[int, Place, float], Grid]] = {}
        self._product: Grid | None = None

    def configure(self, settings: dict[str, Any]) -> None:
        self._pairs = PairTable(FusionSettings.model_validate(settings))

    def warm(self) -> None:
        """Load compiled code, so that the first fusion does not wait for it."""
        from common.fusion.warmup import warmup

        warmup()

    def put(
        self,
        robot: str,
        resolution: float,
        version: int,
        final: bool,
        cover: dict[str, Any],
        tiles: list[tuple[int, int, bytes]],
        whole: bool,
    ) -> None:
        """Tiles of a robot map, which then is this version; `whole`: all there are, otherwise what has changed.

        What is held stays as it is when they are refused: it goes on being fused with the others.
        """
        old, grid = self._maps.get(robot), Grid(resolution)
        if old is not None and not whole and old.resolution == resolution:
            grid = Grid(resolution, dict(old.tiles), old.version, dict(old.changed))
        grid.replace([((x, y), decode_counts(data, robot)) for x, y, data in tiles])
        self._pairs.put(robot, MatchMap.from_grid(grid), version, final)
        self._maps[robot], self._covers[robot] = grid, cover
        self._rendered.pop(robot, None)

    def forget(self, robot: str) -> None:
        self._maps.pop(robot, None)
        self._covers.pop(robot, None)
        self._rendered.pop(robot, None)
        self._pairs.forget(robot)

    def fuse(self, edge: str, robots: list[str], world: bytes | None) -> dict[str, Any]:
        """Fuse the maps of `robots`; gives encoded Verdicts, the components, and what exactly is in the edge map."""
        begin = time.perf_counter()
        held = [robot for robot in robots if robot in self._maps]
        transforms = decode(world) if world is not None else None
        told = transforms if isinstance(transforms, Transforms) else None
        self._pairs.decide(all_pairs(held), places(told))
        verdicts = [self._pairs.verdicts[pair] for pair in all_pairs(held)]
        solved = solve(held, measurements(verdicts))
        placed, epoch, resolution = self._placed(held, solved, told)
        if self._product is None or self._product.resolution != resolution:
            self._product = Grid(resolution, version=first_version(secrets.randbits(32)))
        compose_into(self._product, [self._render(robot, placed[robot], resolution) for robot in sorted(placed)])
        return {
            "verdicts": encode(Verdicts(owner=f"edge/{edge}", pairs=tuple(verdicts))),
            "components": [component(each).model_dump() for each in solved],
            "covers": {robot: self._covers[robot] for robot in sorted(placed)},
            "final": all(self._pairs.known[robot].final for robot in held) and sorted(placed) == sorted(robots),
            "version": self._product.version,
            "world_epoch": epoch,
            "resolution": resolution,
            "area_m2": self._product.known_m2(),
            "seconds": time.perf_counter() - begin,
        }

    def tiles(self, since: int, cursor: str, limit_bytes: int) -> dict[str, Any]:
        """One page of changed tiles of the edge map."""
        if self._product is None:
            raise UsageError("no edge map yet: nothing has been fused here")
        return counts_page(self._product, since, cursor, limit_bytes)

    def _placed(
        self, held: list[str], solved: list[Solved], world: Transforms | None
    ) -> tuple[dict[str, Place], int, float]:
        """Where each map is to be rendered, the world epoch (0: on the edge's own lattice), and the resolution."""
        if world is not None:
            placed = {name: (each.transform, each.warp) for name, each in world.robots.items() if name in held}
            return placed, world.world_epoch, world.resolution
        boxes = {
            each.id: bounds((self._pairs.known[name].map, each.transforms[name]) for name in each.robots)
            for each in solved
        }
        places = lay_out(boxes)
        poses = {name: compose(places[each.id], each.transforms[name]) for each in solved for name in each.robots}
        resolution = min((self._maps[name].resolution for name in held), default=0.05)
        return {name: (FixedPose.of(*(float(v) for v in pose)), None) for name, pose in poses.items()}, 0, resolution

    def _render(self, robot: str, place: Place, resolution: float) -> Grid:
        key = (self._maps[robot].version, place, resolution)
        known = self._rendered.get(robot)
        if known is None or known[0] != key:
            pose, warp = place
            known = (key, cap_votes(render(self._maps[robot], pose.pose(), resolution, warp), VOTES))
            self._rendered[robot] = known
        return known[1]
