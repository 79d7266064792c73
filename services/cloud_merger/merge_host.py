"""What runs inside the cloud's merging process: pairs across edges, the world's transforms, the sum of edge maps."""

from __future__ import annotations

import secrets
import time
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import UsageError
from common.fusion.joint import Robot, correct
from common.fusion.layout import bounds, lay_out
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, component, places
from common.fusion.settings import FusionSettings
from common.fusion.solve import Solved, solve
from common.fusion.verdicts import measurements
from common.geometry.se2 import compose
from common.grid import Grid
from common.grid.compose import compose_into
from common.grid.paging import counts_page
from common.grid.raster import Raster
from common.grid.tiles import decode_counts, decode_occupancy
from common.grid.versions import first_version
from common.wire import FixedPose, Placed, PoseTuple, Transforms, Verdicts, decode, encode
from services.cloud_merger.changes import reason


class MergeHost:
    """Called through common.workers; arguments and results are plain msgpack values."""

    def __init__(self) -> None:
        self._pairs = PairTable()
        self._parts: dict[str, tuple[int, Grid]] = {}
        """edge → version and edge map"""
        self._product: Grid | None = None

    def configure(self, settings: dict[str, Any]) -> None:
        self._pairs = PairTable(FusionSettings.model_validate(settings))

    def warm(self) -> None:
        from common.fusion.warmup import warmup

        warmup()

    def put_sketch(
        self, robot: str, resolution: float, version: int, final: bool, tiles: list[tuple[int, int, bytes]]
    ) -> int:
        """The whole sketch of a robot's map of this version. Gives the number of known cells."""
        raster = Raster(resolution)
        raster.replace(((x, y), decode_occupancy(data, robot)) for x, y, data in tiles)
        map_ = MatchMap.of(*raster.dense(), resolution)
        self._pairs.put(robot, map_, version, final)
        return map_.known_cells

    def forget(self, robot: str) -> None:
        self._pairs.forget(robot)

    def put_part(
        self, edge: str, resolution: float, version: int, tiles: list[tuple[int, int, bytes]], whole: bool
    ) -> None:
        """Tiles of an edge map, which then is this version; `whole`: all there are, otherwise what has changed."""
        _, grid = self._parts.get(edge, (0, None))
        if grid is None or whole or grid.resolution != resolution:
            grid = Grid(resolution)
        grid.replace([((x, y), decode_counts(data, edge)) for x, y, data in tiles])
        self._parts[edge] = version, grid

    def solve(
        self,
        robots: list[str],
        pairs: list[tuple[str, str]],
        verdicts: bytes,
        final: bool,
        previous: bytes | None,
        above: int,
        starts: dict[str, PoseTuple],
    ) -> dict[str, Any]:
        """Encoded Transforms of the world, of an epoch higher than `above` if they are new, and encoded Verdicts of the
        pairs decided here. `verdicts` are the edges': taken for other pairs, and for searches of the same final maps.
        """
        begin = time.perf_counter()
        known = [robot for robot in robots if robot in self._pairs.known]
        before = decode(previous) if previous is not None else None
        old = before if isinstance(before, Transforms) else None
        told = decode(verdicts)
        theirs = told.pairs if isinstance(told, Verdicts) else ()
        self._pairs.decide(((a, b) for a, b in pairs), places(old), theirs)
        own = {(a, b): self._pairs.verdicts[a, b] for a, b in pairs if (a, b) in self._pairs.verdicts}
        every = [*own.values(), *(each for each in theirs if (each.a, each.b) not in own)]
        measured = measurements(every) | self._pairs.told_by_starts(every, starts)
        anchors = {} if final or old is None else {name: each.transform.pose() for name, each in old.robots.items()}
        solved = solve(known, measured, starts=starts, anchors=anchors)
        transforms = self._world(solved, final, old, above)
        return {
            "transforms": encode(transforms),
            "verdicts": encode(Verdicts(owner="cloud", pairs=tuple(own.values()))),
            "seconds": time.perf_counter() - begin,
            "checks": self._pairs.checks,
            "merged": sorted(measured.keys() - {pair for each in solved for pair in each.left_out}),
        }

    def correct(self, transforms: bytes, pairs: list[tuple[str, str]], tracks: dict[str, bytes]) -> dict[str, Any]:
        """The encoded Transforms of a solved world, bent maps straightened together (see common.fusion.joint).

        `pairs` are the merged ones it rests on, `tracks` trajectories as rows of stamp, x, y and theta, float64.
        """
        begin = time.perf_counter()
        world = decode(transforms)
        assert isinstance(world, Transforms)
        robots = {
            name: Robot(
                self._pairs.known[name].map,
                np.frombuffer(rows, np.float64).reshape(-1, 4),
                np.array(world.robots[name].transform.pose()),
            )
            for name, rows in sorted(tracks.items())
        }
        joint = correct(robots, [(a, b) for a, b in pairs], self._pairs.settings)
        placed = {name: each.model_copy(update={"warp": joint.warps.get(name)}) for name, each in world.robots.items()}
        done = world.model_copy(update={"robots": placed, "reason": f"{world.reason}; {joint.told}"})
        return {"transforms": encode(done), "seconds": time.perf_counter() - begin}

    def compose(self, versions: dict[str, int]) -> dict[str, Any] | None:
        """Add the maps of these edges; gives the version and digest of the sum.

        None when another version is held of one: what the sum is said to contain would not be in it.
        """
        begin = time.perf_counter()
        if any(edge not in self._parts or self._parts[edge][0] != version for edge, version in versions.items()):
            return None
        parts = [self._parts[edge][1] for edge in sorted(versions)]
        resolution = parts[0].resolution if parts else 0.05
        if self._product is None or self._product.resolution != resolution:
            self._product = Grid(resolution, version=first_version(secrets.randbits(32)))
        compose_into(self._product, parts, sharpen=True)
        return {
            "version": self._product.version,
            "resolution": resolution,
            "digest": self._product.digest(),
            "seconds": time.perf_counter() - begin,
        }

    def tiles(self, since: int, cursor: str, limit_bytes: int) -> dict[str, Any]:
        """One page of changed tiles of the global map."""
        if self._product is None:
            raise UsageError("no global map yet; wait for the first notice")
        return counts_page(self._product, since, cursor, limit_bytes)

    def export(self, folder: str) -> None:
        """Write the global map into the folder, as map_server yaml + pgm and as PNG."""
        from common.formats.map_server import write_map
        from common.formats.picture import write_png

        if self._product is None:
            raise UsageError("no global map yet; wait for the first notice")
        cells, (x, y) = self._product.occupancy()
        resolution = self._product.resolution
        origin = (x * resolution, y * resolution, 0.0)
        path = Path(folder) / "global_map"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_map(path, cells, resolution, origin)
        write_png(path.with_suffix(".png"), cells, resolution, origin)

    def _world(self, solved: list[Solved], final: bool, old: Transforms | None, above: int) -> Transforms:
        boxes = {
            each.id: bounds((self._pairs.known[name].map, each.transforms[name]) for name in each.robots)
            for each in solved
        }
        places = lay_out(boxes, {each.id: (0.0, 0.0, 0.0) for each in solved if each.in_world})
        poses = {name: compose(places[each.id], each.transforms[name]) for each in solved for name in each.robots}
        ids = {name: each.id for each in solved for name in each.robots}
        placed = {
            name: Placed(
                transform=FixedPose.of(*(float(v) for v in pose)),
                component=ids[name],
                version=self._pairs.known[name].version,
            )
            for name, pose in sorted(poses.items())
        }
        resolution = min((each.map.resolution for each in self._pairs.known.values()), default=0.05)
        fresh = Transforms(
            world_epoch=max(above, old.world_epoch if old is not None else 0) + 1,
            final=final,
            resolution=resolution,
            robots=placed,
            components=tuple(component(each) for each in solved),
            reason=reason(placed, old.robots if old else None, old is not None and old.final, final),
        )
        return fresh if fresh.reason or old is None else old
