"""Rigid fusion against joint correction: real logs cut among robots, two runs in one lab, simulated fleets.

    RECSLAM_DATA=... python -m bench.joint [--scenes]

Intel is scored by relations across robots, ACES and CSAIL by the reference poses of another program, simulated scenes
by the true poses and walls (`--scenes`: robots with an LDS-01 and worn wheels). CPU time of one process.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.slam_cuts import LOGS, PARTS, made
from common.evaluation.maps import score_occupancy
from common.evaluation.relations import read_odometry, read_relations, score_relations
from common.evaluation.trajectory import absolute_error, fit_all
from common.formats.rover import RoverLog
from common.fusion.joint import Joint, Robot, correct
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, all_pairs
from common.fusion.solve import solve
from common.fusion.verdicts import measurements
from common.geometry import compose
from common.grid import Grid
from common.grid.compose import add, cap_votes, compose_into
from common.grid.render import render
from common.grid.warp import straightened
from common.sim import SimulatedRobot, load_scene
from common.sim.truth import visible_walls
from common.wire import Warp
from services.edge_worker.fusion_host import VOTES
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack

RESOLUTION_M = 0.05
SCENES = {"apartment": 6, "factory": 4}
RIGID = Joint({}, 0.0, 0.0, 0.0)


class Fused(NamedTuple):
    """Robots of the largest component, as placed rigidly and as corrected."""

    robots: dict[str, Robot]
    joint: Joint
    components: int
    seconds: float
    """CPU time of the correction alone"""

    def tracks(self, joint: Joint) -> dict[str, NDArray[np.float64]]:
        """robot → (n, 4) in the world"""
        return {name: _placed(each, joint.warps.get(name)) for name, each in self.robots.items()}


def _placed(robot: Robot, warp: Warp | None) -> NDArray[np.float64]:
    straight = straightened(warp, robot.trajectory[:, 1:])
    return np.column_stack([robot.trajectory[:, 0], compose(robot.placed, straight)])


def fuse(maps: Mapping[str, MatchMap], trajectories: Mapping[str, NDArray[np.float64]]) -> Fused:
    table = PairTable()
    for name in sorted(maps):
        table.put(name, maps[name], 1, True)
    table.decide(all_pairs(maps))
    measured = measurements(table.verdicts.values())
    components = solve(sorted(maps), measured)
    largest = max(components, key=lambda each: len(each.robots))
    robots = {name: Robot(maps[name], trajectories[name], largest.transforms[name]) for name in largest.robots}
    begin = time.process_time()
    joint = correct(robots, measured.keys() - largest.left_out.keys())
    return Fused(robots, joint, len(components), time.process_time() - begin)


def cuts(data: Path) -> None:
    """Logs cut by time among two, three and four robots."""
    every = made(data)
    relations = read_relations(data / "relations/intel.relations.gz")
    odometry = read_odometry(data / LOGS["intel"][0])
    for building in LOGS:
        for parts in PARTS:
            mine = {f"r{each.cut[0]}": each for each in every if (each.building, each.cut[1]) == (building, parts)}
            fused = fuse({n: e.map for n, e in mine.items()}, {n: e.trajectory for n, e in mine.items()})
            if len(fused.robots) == 1:
                print(f"{building} cut in {parts}: no two maps merge", flush=True)
                continue
            told = []
            for joint in (RIGID, fused.joint):
                tracks = list(fused.tracks(joint).values())
                if building == "intel":
                    score = score_relations(relations, odometry, tracks)
                    told.append(f"{score.stats(across=True).translation:.4f}")
                else:
                    reference = np.loadtxt(data / LOGS[building][1])
                    told.append(f"{absolute_error(tracks, [reference] * len(tracks), 10.0).rmse:.3f}")
            print(f"{building} cut in {parts}: {line(fused)}; {' -> '.join(told)} m", flush=True)


def rover(data: Path) -> None:
    """Two runs of one rover in one lab."""
    runs = {name: list(RoverLog(data / "multi_session" / f"{name}.dat.gz")) for name in ("exp1", "exp2")}
    maps, trajectories = {}, {}
    for name, sweeps in runs.items():
        kernel = create("graph", {}, 0)
        for seq, sweep in enumerate(sweeps):
            kernel.process(pack(sweep, name, "0" * 32, seq))
        kernel.finish()
        maps[name], trajectories[name] = MatchMap.from_grid(kernel.map()), kernel.trajectory()
    print(f"exp1 + exp2: {line(fuse(maps, trajectories))}", flush=True)


def scene(name: str, robots: int) -> None:
    """Simulated robots with a poor laser and worn wheels."""
    world = load_scene(name)
    drivers = [SimulatedRobot(world, f"r{k + 1}", 1, lidar="lds01", noise="worn", imu=False) for k in range(robots)]
    grids, trajectories, truths = {}, {}, {}
    for driver in drivers:
        kernel = create("graph", {}, 0)
        for seq, sweep in enumerate(driver.sweeps()):
            kernel.process(pack(sweep, driver.robot, "0" * 32, seq))
        kernel.finish()
        rows = kernel.trajectory()
        grids[driver.robot], trajectories[driver.robot] = kernel.map(), rows
        truths[driver.robot] = np.column_stack([rows[:, 0], driver.poses(rows[:, 0])])
    fused = fuse({n: MatchMap.from_grid(g) for n, g in grids.items()}, trajectories)
    walls = visible_walls(world, [driver for driver in drivers if driver.robot in fused.robots], RESOLUTION_M)
    told = []
    for joint in (RIGID, fused.joint):
        tracks = fused.tracks(joint)
        pose, moved, matched = fit_all(list(tracks.values()), [truths[n] for n in tracks])
        rendered = [
            cap_votes(render(grids[n], each.placed, RESOLUTION_M, joint.warps.get(n)), VOTES)
            for n, each in fused.robots.items()
        ]
        product = Grid(RESOLUTION_M)
        compose_into(product, [add(rendered)], sharpen=True)
        occupancy, (x, y) = product.occupancy()
        origin = (x * RESOLUTION_M, y * RESOLUTION_M, 0.0)
        iou = score_occupancy(occupancy, RESOLUTION_M, walls, origin=origin, pose=pose).iou
        told.append(f"IoU {iou:.3f}, ATE {absolute_error(moved, matched, align=False).rmse:.3f} m")
    print(f"{name}, {len(fused.robots)} of {robots} robots: {line(fused)}; {' -> '.join(told)}", flush=True)


def line(fused: Fused) -> str:
    size = sum(each.trajectory.nbytes for each in fused.robots.values()) / 1024
    return f"{fused.components} components; {fused.joint.told}; {1e3 * fused.seconds:.0f} ms, {size:.0f} KB fetched"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", action="store_true", help="simulated fleets instead of logs")
    if parser.parse_args().scenes:
        for name, robots in SCENES.items():
            scene(name, robots)
        return
    data = Path(os.environ["RECSLAM_DATA"])
    rover(data)
    cuts(data)


if __name__ == "__main__":
    main()
