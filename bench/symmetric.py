"""Symmetric worlds: never merged wrongly, ambiguous until evidence comes, then right.

    python -m bench.symmetric [--seeds 100] [--world square ...]

Three worlds in which places look alike: the square of 4 x 4 m, a hotel corridor of equal rooms, and a hall that is its
own mirror image both ways. Two or three robots drive through each, their waypoints moved a little by the seed, and the
graph kernel maps. The fleet is fused three times: with nothing known, with start poses that are 0.1 m and 3 degrees
off, and (driven anew) in the same world with a closet or a few (LANDMARKS) that make it unlike. A robot is wrong when
it lies more than 0.3 m or 3 degrees from where it belongs in its component.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.cuts import Cut, error
from bench.results import append
from bench.worlds import drive
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, all_pairs
from common.fusion.solve import solve
from common.fusion.verdicts import measurements
from common.geometry import between
from common.sim import load_scene
from common.sim.scene import Scene
from common.sim.world import Plan, World

RIGHT_M, RIGHT_RAD = 0.3, math.radians(3)
STRAY_M = 0.1
"""m that waypoints stray by the seed"""
START_SPREAD = (0.1, 0.1, math.radians(3))

Maps = dict[str, tuple[MatchMap, NDArray[np.float64]]]


@dataclass(frozen=True)
class Row:
    """One fleet of one seed, fused under one condition."""

    world: str
    seed: int
    known: str
    """nothing, starts or landmark"""
    robots: int
    components: int
    wrong: int
    """robots that lie wrongly in their component"""
    kinds: dict[str, int]
    """verdicts on the pairs"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--world", action="append", choices=sorted(WORLDS))
    options = parser.parse_args()
    for world in options.world or sorted(WORLDS):
        rows: list[Row] = []
        for seed in range(options.seeds):
            rows += judge(world, seed)
            append("symmetric", {world: [asdict(row) for row in rows]})
        for known in ("nothing", "starts", "landmark"):
            print(line([row for row in rows if row.known == known]), flush=True)


def judge(world: str, seed: int) -> list[Row]:
    rng = np.random.default_rng([seed, 7])
    plain = stray(WORLDS[world](), rng)
    maps = {robot: drive(plain, robot, seed) for robot in sorted(plain.routes)}
    starts = {robot: frame + rng.normal(0, 1, 3) * START_SPREAD for robot, (_, frame) in maps.items()}
    marked = with_landmark(plain)
    again = {robot: drive(marked, robot, seed) for robot in sorted(marked.routes)}
    return [
        fuse(world, seed, "nothing", maps, {}),
        fuse(world, seed, "starts", maps, starts),
        fuse(world, seed, "landmark", again, {}),
    ]


def fuse(world: str, seed: int, known: str, maps: Maps, starts: dict[str, NDArray[np.float64]]) -> Row:
    """As the cloud does for final maps."""
    table = PairTable()
    for robot, (map_, _) in maps.items():
        table.put(robot, map_, 1, True)
    table.decide(all_pairs(maps))
    told = table.told_by_starts(table.verdicts.values(), starts)
    components = solve(sorted(maps), measurements(table.verdicts.values()) | told, starts=starts)
    wrong = 0
    for each in components:
        first = each.robots[0]
        for robot in each.robots[1:]:
            truth = between(maps[first][1], maps[robot][1])
            estimate = between(each.transforms[first], each.transforms[robot])
            gap = error(estimate, Cut(maps[first][0], maps[robot][0], truth, 0.0, False))
            wrong += gap[0] > RIGHT_M or gap[1] > RIGHT_RAD
    kinds = Counter(str(each.kind) for each in table.verdicts.values())
    return Row(world, seed, known, len(maps), len(components), wrong, dict(kinds))


def stray(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with its waypoints moved a little."""
    routes = {robot: way + rng.uniform(-STRAY_M, STRAY_M, way.shape) for robot, way in scene.routes.items()}
    return replace(scene, routes=routes)


def square() -> Scene:
    scene = load_scene("symmetric")
    return replace(scene, routes={robot: scene.routes[robot] for robot in ("r1", "r2", "r3")})


ROOMS, ROOM_M, DEPTH_M, CORRIDOR_M = 6, 3.2, 3.6, 1.8


def hotel() -> Scene:
    """Equal rooms on both sides of a corridor; robots look into neighbouring rooms along different stretches of it."""
    plan, length, far = Plan(), ROOMS * ROOM_M, DEPTH_M + CORRIDOR_M
    plan.room(0, 0, length, 2 * DEPTH_M + CORRIDOR_M)
    for low, high, wall in ((0.0, DEPTH_M, DEPTH_M), (far, far + DEPTH_M, far)):
        doors = [(ROOM_M * k + 1.1, ROOM_M * k + 2.1) for k in range(ROOMS)]
        plan.wall((0, wall), (length, wall), doors=doors, thickness=0.1)
        for k in range(1, ROOMS):
            plan.wall((ROOM_M * k, low), (ROOM_M * k, high), thickness=0.1)
        bed = low + 0.1 if low == 0 else high - 1.0
        for k in range(ROOMS):
            plan.box(ROOM_M * k + 0.1, bed, 1.9, 0.9)
    middle, door = DEPTH_M + CORRIDOR_M / 2, 1.6
    routes = {}
    for robot, rooms in {"r1": (0, 1, 2), "r2": (2, 3, 4), "r3": (3, 4, 5)}.items():
        way = []
        for k in rooms:
            x = ROOM_M * k + door
            way += [(x, middle), (x, DEPTH_M - 1.5), (x, middle), (x, far + 1.5), (x, middle)]
        routes[robot] = np.array(way)
    return Scene("hotel", plan.world(), (door, middle), routes)


def hall() -> Scene:
    """12 x 8 m with pillars and alcoves, its own mirror image in both directions."""
    plan = Plan()
    plan.room(0, 0, 12, 8)
    for x in (3.0, 9.0):
        for y in (2.4, 5.6):
            plan.box(x - 0.25, y - 0.25, 0.5, 0.5)
        plan.wall((x, 0), (x, 1.0), thickness=0.12)
        plan.wall((x, 7.0), (x, 8), thickness=0.12)
    for x in (0.0, 11.2):
        plan.box(x + 0.02, 3.4, 0.76, 1.2)
    around = np.array([(1.5, 1.6), (5.0, 1.6), (6.0, 4.0), (4.5, 6.4), (1.5, 6.0), (1.6, 2.0)])
    across = np.array([(6.0, 1.2), (7.0, 4.0), (6.0, 6.8), (4.5, 4.0), (2.0, 4.0), (6.0, 4.0), (10.0, 4.0)])
    return Scene("hall", plan.world(), (6.0, 4.0), {"r1": around, "r2": (12, 8) - around, "r3": across})


WORLDS: dict[str, Callable[[], Scene]] = {"square": square, "hotel": hotel, "hall": hall}
LANDMARKS = {
    "symmetric": [(2.75, 0.05, 1.2, 1.1, 0.0)],
    "hotel": [(8.7, 3.65, 1.0, 0.5, 0.0), (8.75, 0.1, 0.75, 1.0, 0.0), (15.1, 7.9, 0.8, 1.0, 0.0)],
    "hall": [(4.2, 2.9, 0.9, 0.5, 0.5), (6.6, 5.2, 0.6, 0.4, 0.2)],
}
"""Boxes x, y, width, depth (m), turn (rad), where two robots or more come by.

They are as large as a closet; the square's fills a corner, for no place there is far from a wall. What stands less than
0.25 m off a wall is no evidence (FusionSettings.contradiction_m), so that a narrow thing along a wall tells nobody one
place from another.
"""


def with_landmark(scene: Scene) -> Scene:
    plan = Plan()
    for x, y, width, depth, turn in LANDMARKS[scene.name]:
        plan.box(x, y, width, depth, turn=turn)
    segments = np.concatenate([scene.world.segments, plan.world().segments])
    return replace(scene, name=f"{scene.name} marked", world=World(segments))


def line(rows: list[Row]) -> str:
    kinds = sum((Counter(row.kinds) for row in rows), Counter[str]())
    told = ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items()))
    whole = sum(row.components == 1 and row.wrong == 0 for row in rows)
    wrong = sum(row.wrong > 0 for row in rows)
    return (
        f"{rows[0].world:7} {rows[0].known + ' known':15} {len(rows)} runs: {wrong} with a wrong merge, "
        f"{whole} one right map; pairs: {told}"
    )


if __name__ == "__main__":
    main()
