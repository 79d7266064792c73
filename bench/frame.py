"""How still the world stands: walls of consecutive versions of the global map, matched and compared.

    python -m bench.frame [--fleet apartment] [--seconds 600] [--realtime] [--noise hostile]

Runs the fleet, takes every version of the global map that it can, and compares each with the one before. Walls are
compared patch by patch (2 x 2 m) and direction by direction: a patch has moved by the median step across its walls,
of walls that run alike and lie within half a metre. Declared are the events that the cloud names: new world epochs,
and what has changed in robot maps beside their growth: SLAM has corrected one, or another one is in it.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.results import append
from common.bus import Bus, keys
from common.bus.tiles import fetch_tiles
from common.config import Fleet
from common.errors import PeerError
from common.fusion.matchmap import MatchMap
from common.fusion.walls import SAME_WAY, STRAIGHT
from common.grid import Grid
from common.grid.grid import UNKNOWN
from common.grid.tiles import decode_counts
from common.wire import GlobalMapNotice, Transforms
from services.cloud_merger.changes import changed
from services.command import fleets
from services.command.run_folder import RunFolder, read_cluster

PATCH_M = 2.0
MIN_WALLS = 20
"""wall cells of one direction that a patch is judged by"""


@dataclass(frozen=True)
class Step:
    """From one version of the global map to the next."""

    version: int
    epochs: tuple[int, int]
    declared: str
    """what the cloud says about the new world epoch and of robot maps; empty: nothing is declared"""
    worst_m: float
    """of all patches"""
    share_still: float
    """of patches: moved by no more than half a cell"""
    patches: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleet", default="apartment")
    parser.add_argument("--seconds", type=float, default=600.0, help="stop here at the latest")
    parser.add_argument("--realtime", action="store_true", help="robots drive by the clock, so that more versions come")
    parser.add_argument("--noise", default="good", help="of wheels and gyros")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "frame.toml"
        fleets.write(fleet(options), file)
        command = [str(Path(sys.executable).with_name("recslam")), "up", str(file), "--out", folder, "--keep"]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            versions, reasons = asyncio.run(record(RunFolder(Path(folder)), run, options.seconds))
        finally:
            run.send_signal(signal.SIGINT)
            run.wait()
    steps = [compare(one, other, reasons) for one, other in pairwise(versions)]
    if not steps:
        raise SystemExit("fewer than two versions came; give it more --seconds")
    half = versions[0][1].resolution / 2
    for step in steps:
        print(
            f"epoch {step.epochs[0]} -> {step.epochs[1]}: worst {step.worst_m * 1000:5.1f} mm of {step.patches:3} "
            f"patches, {step.share_still:.0%} still  {step.declared}"
        )
    quiet = [step for step in steps if not step.declared]
    moved = sum(step.worst_m > half for step in quiet)
    print(f"{len(steps)} steps, {len(steps) - len(quiet)} declared; {moved} of the others moved by over half a cell")
    append("frame", {f"{options.fleet}, {options.noise} wheels": [asdict(step) for step in steps]})


def fleet(options: argparse.Namespace) -> Fleet:
    loaded = fleets.load_fleet(options.fleet, robot={"realtime": options.realtime})
    robots = [entry.model_dump() for entry in loaded.robots]
    return fleets.revised(
        loaded, robots=[{**robot, "source": {**robot["source"], "noise": options.noise}} for robot in robots]
    )


Version = tuple[GlobalMapNotice, MatchMap]
Indices = NDArray[np.int64]


async def record(
    folder: RunFolder, run: subprocess.Popen[bytes], seconds: float
) -> tuple[list[Version], dict[int, str]]:
    """All versions that came until the final one or the time is over, and what was declared by world epoch."""
    while not folder.cluster.exists():
        if run.poll() is not None:
            raise SystemExit("the fleet has not started; try `recslam up` to see why")
        await asyncio.sleep(0.1)
    cluster = read_cluster(folder.cluster)
    versions: list[Version] = []
    reasons: dict[int, str] = {}
    async with await Bus.open(cluster.endpoint, name="frame bench", role="client", root=cluster.root) as bus:

        async def declared() -> None:
            async for received in bus.watch(keys.CLOUD_TRANSFORMS):
                if isinstance(received.message, Transforms):
                    reasons[received.message.world_epoch] = received.message.reason

        async def taken() -> None:
            grid, held = Grid(0.05), 0
            async for received in bus.watch(keys.CLOUD_MAP):
                notice = received.message
                if not isinstance(notice, GlobalMapNotice):
                    continue
                try:
                    delta = await fetch_tiles(bus, keys.CLOUD_MAP, held)
                except PeerError:
                    continue
                if delta.whole:
                    grid = Grid(delta.resolution)
                grid.replace([((tile.x, tile.y), decode_counts(tile.data, "cloud")) for tile in delta.tiles])
                held = delta.version
                told = notice.model_copy(update={"world_epoch": delta.world_epoch, "covers": delta.covers})
                versions.append((told, MatchMap.from_grid(grid)))
                if notice.final and delta.final:
                    return

        listening = asyncio.create_task(declared())
        with suppress(TimeoutError):
            await asyncio.wait_for(taken(), seconds)
        listening.cancel()
    return versions, reasons


def compare(before: Version, after: Version, reasons: dict[int, str]) -> Step:
    epochs = before[0].world_epoch, after[0].world_epoch
    told = list(changed(after[0].covers, before[0].covers))
    told += [reasons.get(epoch, "a new world epoch") for epoch in range(epochs[0] + 1, epochs[1] + 1)]
    moves = patches(before[1], after[1])
    half = after[1].resolution / 2
    worst, still = (float(moves.max()), float((moves <= half).mean())) if len(moves) else (0.0, 1.0)
    return Step(after[0].version, epochs, "; ".join(told), worst, still, len(moves))


def patches(before: MatchMap, after: MatchMap) -> NDArray[np.float64]:
    """How far each patch of known walls has moved (n,), m: of walls that are nearest to each other, old and new."""
    after = without_new(before, after)
    old, new = mutual(before, after)
    normals = before.walls.normals[old], after.walls.normals[new]
    straight = (before.walls.straightness[old] > STRAIGHT) & (after.walls.straightness[new] > STRAIGHT)
    chosen = straight & (np.abs((normals[0] * normals[1]).sum(axis=1)) > SAME_WAY)
    old, new, across = old[chosen], new[chosen], normals[0][chosen]
    across = across * np.where(across @ (1.0, 0.01) < 0, -1.0, 1.0)[:, None]
    steps = ((after.walls.points[new] - before.walls.points[old]) * across).sum(axis=1)
    way = (np.floor(np.arctan2(across[:, 1], across[:, 0]) / (np.pi / 4) + 0.5)).astype(np.int64)
    places = np.column_stack([np.floor(after.walls.points[new] / PATCH_M).astype(np.int64), way])
    _, patch = np.unique(places, axis=0, return_inverse=True)
    patch = patch.ravel()
    groups = [steps[patch == k] for k in range(int(patch.max(initial=-1)) + 1)]
    return np.array([abs(float(np.median(group))) for group in groups if len(group) >= MIN_WALLS])


def without_new(before: MatchMap, after: MatchMap) -> MatchMap:
    """The later map without walls that are seen for the first time.

    The other face of a wall that stands where it stood draws the middle of both to itself, and nothing has moved. What
    is new where nothing was known, and not what is left of a wall that stands there no more, is such a one.
    """
    _, moved = mutual(before, after)
    (row, column), inside = cells_in(before, after)
    fresh = np.ones(len(inside), np.bool_)
    fresh[inside] = before.occupancy[row[inside], column[inside]] == UNKNOWN
    fresh[moved] = False
    kept = after.occupancy.copy()
    kept[tuple(after.walls.cells[fresh].T)] = UNKNOWN
    return MatchMap.of(kept, after.origin_cell, after.resolution)


def mutual(before: MatchMap, after: MatchMap) -> tuple[Indices, Indices]:
    """Pairs of walls (n,), (n,) of which none has a nearer one in the other map."""
    old, gap = nearest(before, after)
    _, back = nearest(after, before)
    new = np.flatnonzero(old >= 0)
    new = new[gap[new] <= back[old[new]] + 1e-9]
    return old[new], new


def nearest(map_: MatchMap, other: MatchMap) -> tuple[Indices, NDArray[np.float64]]:
    """For each wall of the other map the nearest of this one (n,), -1 where none is in reach, and its distance, m."""
    (row, column), inside = cells_in(map_, other)
    found, gap = np.full(len(inside), -1), np.full(len(inside), np.inf)
    found[inside] = map_.nearest.wall[row[inside], column[inside]]
    gap[inside] = map_.nearest.distance(row[inside], column[inside])
    return found, gap


def cells_in(map_: MatchMap, other: MatchMap) -> tuple[Indices, NDArray[np.bool_]]:
    """Where the other map's wall cells lie in this one: rows and columns (2, n), and which are inside (n,)."""
    cells = other.walls.cells + np.subtract(other.origin_cell, map_.origin_cell)[::-1]
    return cells.T, np.asarray(((cells >= 0) & (cells < map_.occupancy.shape)).all(axis=1))


if __name__ == "__main__":
    main()
