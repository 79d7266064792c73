"""Why two robots' maps are merged, or are not: the verdict on the pair, the evidence, and a picture of it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np

from common.bus import Bus, keys
from common.bus.tiles import fetch_tiles
from common.errors import QueryFailed, UsageError
from common.formats.picture import encode_png
from common.fusion.match import match
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import seed_of
from common.fusion.picture import overlay
from common.geometry import between
from common.geometry.se2 import Pose
from common.grid.raster import Raster
from common.grid.tiles import decode_occupancy
from common.wire import PairVerdict, Routes, Transforms, Verdicts
from services.command import collect

MEANING = {
    "merged": "their maps show one place and are merged",
    "ambiguous": "there is a placement, but another one is about as good",
    "no_overlap": "no placement shares enough: they have not seen the same place, or not enough of it",
    "conflict": "the best placement is contradicted by what both have seen",
    "insufficient": "a map holds too little to be compared yet",
}


async def verdict_on(bus: Bus, a: str, b: str) -> tuple[PairVerdict, str]:
    """The verdict on the two robots, named in sorted order, and who decided it. Raises UsageError when nobody has."""
    if a == b:
        raise UsageError(f"{a} and {b}: name two robots")
    names = tuple(sorted((a, b)))
    cloud = await collect.several(bus, keys.CLOUD_VERDICTS, Verdicts)
    edges = await collect.several(bus, keys.edge_verdicts(keys.ANY), Verdicts)
    known: set[str] = set()
    for said in (*cloud, *edges):
        for pair in said.pairs:
            if (pair.a, pair.b) == names:
                return pair, said.owner
            known |= {pair.a, pair.b}
    raise UsageError(f"nobody has compared {a} and {b}; compared so far: {', '.join(sorted(known)) or 'no robots'}")


def as_lines(verdict: PairVerdict, owner: str, world: Transforms | None) -> list[str]:
    """For people."""
    final = "final" if verdict.final else "not final"
    lines = [
        f"{verdict.a} - {verdict.b}: {verdict.kind} ({final}, decided by {owner}): {MEANING[verdict.kind]}",
        f"reason     {verdict.reason}",
        f"evidence   overlap {verdict.overlap:.3f} of 0.5, {verdict.agreement:.0%} of the wall there agrees, "
        f"{verdict.conflict:.1%} contradicts",
        f"runner-up  the best other placement scores {verdict.runner_up:.0%} of the best",
    ]
    if verdict.transform is not None:
        x, y, theta = verdict.transform
        lines.append(f"transform  {verdict.b} in {verdict.a}: {x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f} degrees")
    if world is not None:
        lines.append(f"world      {_together(verdict, world)}")
    return lines


def as_data(verdict: PairVerdict, owner: str, world: Transforms | None) -> dict[str, Any]:
    """For programs."""
    apart = None if world is None else _apart(verdict, world)
    return {**verdict.model_dump(mode="json"), "owner": owner, "one_component": None if apart is None else not apart}


async def world(bus: Bus) -> Transforms | None:
    return await collect.one(bus, keys.CLOUD_TRANSFORMS, Transforms)


async def draw(bus: Bus, verdict: PairVerdict, placed: Transforms | None, path: Path) -> str:
    """Write the robots' sketches laid on each other to `path` (PNG); gives what placement is shown.

    The verdict's own where there is one, else the world's, else the best that was found and not believed.
    """
    a, b = await _sketch(bus, verdict.a), await _sketch(bus, verdict.b)
    pose: Pose | None = None
    shown = "the decided placement"
    if verdict.transform is not None:
        pose = np.array(verdict.transform)
    elif placed is not None and not _apart(verdict, placed):
        shown = "the placement that follows from other pairs"
        pose = between(*(placed.robots[name].transform.pose() for name in (verdict.a, verdict.b)))
    else:
        shown = "the best placement found, which was not believed"
        found = match(a, b, seed=seed_of(verdict.a, verdict.b)).hypotheses
        pose = found[0].pose if found else None
    if pose is None:
        raise UsageError(f"there is no placement to show: {verdict.reason}")
    path.parent.mkdir(parents=True, exist_ok=True)
    blue_first = np.ascontiguousarray(overlay(a, b, pose)[..., ::-1])
    await asyncio.to_thread(path.write_bytes, encode_png(blue_first))
    return shown


async def _sketch(bus: Bus, robot: str) -> MatchMap:
    """The robot's map as the cloud compares it, from the edge that runs it."""
    routes = await collect.one(bus, keys.SCHEDULER_ROUTES, Routes)
    if routes is None or robot not in routes.routes:
        raise QueryFailed("no route tells which edge runs the robot", robot)
    key = keys.edge_robot_map(routes.routes[robot].slam_edge, robot)
    delta = await fetch_tiles(bus, key, kind="occupancy")
    raster = Raster(delta.resolution)
    raster.replace(((tile.x, tile.y), decode_occupancy(tile.data, key)) for tile in delta.tiles)
    return MatchMap.of(*raster.dense(), delta.resolution)


def _apart(verdict: PairVerdict, world: Transforms) -> bool:
    """Whether the robots lie in different components, or one lies nowhere."""
    parts = [world.robots[name].component if name in world.robots else None for name in (verdict.a, verdict.b)]
    return None in parts or parts[0] != parts[1]


def _together(verdict: PairVerdict, world: Transforms) -> str:
    missing = [name for name in (verdict.a, verdict.b) if name not in world.robots]
    if missing:
        return f"{', '.join(missing)} not placed yet"
    if _apart(verdict, world):
        return "they lie in different components: nothing tells where one is relative to the other"
    if verdict.kind == "merged":
        return "they lie in one component"
    return "they lie in one component all the same, by other pairs or by start poses"
