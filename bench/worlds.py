"""Verdicts on maps that simulated robots made, symmetric worlds among them: right, honest or wrong.

    python -m bench.worlds [--seeds 3] [--scene symmetric ...]

Robots drive their routes, the graph kernel maps, and every pair of one scene and seed is decided. A merge is right
within 0.3 m and 3 degrees of the truth. In the symmetric square both placements fit: whatever is merged there without
start poses is a guess, right by luck at best.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.cuts import Cut, error
from common.evaluation.trajectory import fit
from common.fusion.match import match
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import seed_of
from common.fusion.picture import overlay, write_png
from common.geometry import between
from common.sim import SimulatedRobot, load_scene
from common.sim.scene import Scene
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack

SCENES = ("symmetric", "asymmetric", "two_rooms", "prototype", "apartment")
RIGHT_M, RIGHT_RAD = 0.3, math.radians(3)
OUT = Path("results")


@dataclass(frozen=True)
class Row:
    """One pair and what became of it."""

    scene: str
    seed: int
    pair: str
    kind: str
    right: bool
    wrong: bool
    error_m: float
    runner_up: float
    reason: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scene", action="append", choices=SCENES)
    options = parser.parse_args()
    OUT.mkdir(exist_ok=True)
    rows = []
    for scene in options.scene or SCENES:
        found = [row for seed in range(options.seeds) for row in judge(scene, seed)]
        print(line(scene, found), flush=True)
        rows += found
    (OUT / "worlds.json").write_text(json.dumps([asdict(row) for row in rows], indent=1))


def judge(scene: str, seed: int) -> Iterator[Row]:
    """Every pair of the scene's first four robots."""
    world = load_scene(scene)
    maps = {robot: drive(world, robot, seed) for robot in sorted(world.routes)[:4]}
    for (a, (map_a, frame_a)), (b, (map_b, frame_b)) in combinations(maps.items(), 2):
        truth = between(frame_a, frame_b)
        result = match(map_a, map_b, seed=seed_of(a, b))
        gap = (math.inf, math.inf)
        if result.transform is not None:
            gap = error(result.transform, Cut(map_a, map_b, truth, 0.0, False))
        merged, right = result.kind == "merged", gap[0] < RIGHT_M and gap[1] < RIGHT_RAD
        if merged and not right:
            write_png(str(OUT / f"wrong-{scene}-{seed}-{a}-{b}.png"), overlay(map_a, map_b, result.hypotheses[0].pose))
        kind, told = result.kind, result.reason
        yield Row(scene, seed, f"{a}-{b}", kind, right, merged and not right, gap[0], result.runner_up, told)


def drive(scene: Scene, robot: str, seed: int) -> tuple[MatchMap, NDArray[np.float64]]:
    """A robot's map, and the pose of its frame in the world by all of its trajectory."""
    simulated = SimulatedRobot(scene, robot, seed)
    kernel = create("graph", {}, 0)
    for seq, sweep in enumerate(simulated.sweeps()):
        kernel.process(pack(sweep, robot, "0" * 32, seq))
    kernel.finish()
    track = kernel.trajectory()
    return MatchMap.from_grid(kernel.map()), fit(track[:, 1:3], simulated.poses(track[:, 0])[:, :2])


def line(scene: str, rows: list[Row]) -> str:
    others = Counter(row.kind for row in rows if row.kind != "merged")
    told = ", ".join(f"{kind} {count}" for kind, count in sorted(others.items()))
    errors = [row.error_m for row in rows if row.right]
    worst = f"{max(errors):.3f}" if errors else "-"
    right, wrong = sum(row.right for row in rows), sum(row.wrong for row in rows)
    return f"{scene:12} {len(rows):3} pairs, {right:3} right (worst {worst} m), {wrong} wrong; {told}"


if __name__ == "__main__":
    main()
