"""Trajectory error and map IoU of the SLAM kernels in all simulated scenes, and with worse or fewer sensors.

    python -m bench.slam_scenes [scenes|sensors] [--seeds 5] [--kernel gmapping] [--scene apartment] [--lidar lds01]
        [--go-on]

Each seed is another route of the scene, driven by another robot with other errors. The map is brought to the truth by
the trajectory, never by itself. `true poses` draws the same scans where they were really taken, and `exact ranges` does
so without the laser's noise: how far this drawing gets with these cells. `every scan` draws all noisy scans at their
true poses, not only one each 0.3 m or rad: what thinning scans costs. What is drawn of a scan is what `graph` draws.
Tables are in metres. Each row is written as it comes to `results/slam_rows.jsonl`; `--go-on` takes
over those that are there.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.evaluation.maps import score_occupancy, wall_thickness
from common.evaluation.trajectory import absolute_error, fit_all
from common.geometry import apply, between, compose, inverse
from common.grid import Grid
from common.sim import SimulatedRobot, load_scene
from common.sim.lidar import true_ranges
from common.sim.truth import visible_walls
from common.sweep import Sweep
from services.edge_worker.slam.raycast import Canvas
from services.edge_worker.slam.registry import create
from services.edge_worker.slam.surfaces import walls
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack

SCENES = ("apartment", "two_rooms", "symmetric", "asymmetric", "prototype", "factory", "office")
LIDARS = ("rplidar_a1", "lds01")
KERNELS = ("graph", "gmapping")
TRUE, EXACT, EVERY = "true poses", "exact ranges", "every scan"
SENSORS = ("wheels+imu", "wheels", "imu", "laser")
NOISE = ("none", "good", "worn", "slippery", "hostile")
LONGEST_S = 300.0
CELL_M = 0.05
APART = 0.3
"""m or rad between the scans that are drawn at true poses: as often as kernels keep one"""
FAILED_M = 0.3
"""a trajectory that is off by more than this anywhere has failed"""
OUT = Path("results")
KEPT = OUT / "slam_rows.jsonl"


@dataclass(frozen=True)
class Case:
    """One robot in one scene."""

    scene: str
    lidar: str
    seed: int
    sensors: str = "wheels+imu"
    noise: str = "good"

    def robot(self) -> SimulatedRobot:
        scene = load_scene(self.scene)
        routes = list(scene.routes)
        robot = SimulatedRobot(
            scene,
            routes[(self.seed - 1) % len(routes)],
            self.seed,
            lidar=self.lidar,
            noise=self.noise,
            imu="imu" in self.sensors,
            wheels="wheels" in self.sensors,
        )
        robot.duration = min(robot.duration, LONGEST_S)
        return robot


@dataclass(frozen=True)
class Row:
    """What one kernel made of a case; errors in m, walls in cells."""

    case: Case
    kernel: str
    rms: float
    most: float
    iou: float
    precision: float
    recall: float
    thickness: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["scenes", "sensors"], help="one of the two tables; both by default")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--kernel", action="append", choices=KERNELS)
    parser.add_argument("--scene", action="append", choices=SCENES)
    parser.add_argument("--lidar", action="append", choices=LIDARS)
    parser.add_argument("--go-on", action="store_true", help="take over the rows that a run with this code has kept")
    options = parser.parse_args()
    kernels, lidars = options.kernel or KERNELS, options.lidar or LIDARS
    seeds = range(1, options.seeds + 1)
    OUT.mkdir(exist_ok=True)
    if not options.go_on:
        KEPT.unlink(missing_ok=True)
    warmup()
    for what in [options.what] if options.what else ["scenes", "sensors"]:
        if what == "scenes":
            cases = [Case(*key) for key in product(options.scene or SCENES, lidars, seeds)]
            columns: tuple[str, ...] = (*kernels, TRUE, EXACT, EVERY)
        else:
            cases = [replace(case, seed=seed) for case in sensed(options.scene, lidars) for seed in seeds]
            columns = tuple(kernels)
        rows = list(measured(cases, columns))
        table = markdown(rows, columns)
        print(table, flush=True)
        (OUT / f"slam_{what}.md").write_text(table)
        (OUT / f"slam_{what}.json").write_text(json.dumps([asdict(row) for row in rows], indent=1))


def sensed(scenes: list[str] | None, lidars: tuple[str, ...]) -> Iterator[Case]:
    """The apartment (or others) with all or some sensors, good or bad; without wheels only the gyro can be bad."""
    for scene, lidar, sensors in product(scenes or ["apartment"], lidars, SENSORS):
        for noise in NOISE if "wheels" in sensors else ("good", "hostile") if sensors == "imu" else ("good",):
            yield Case(scene, lidar, 0, sensors, noise)


def measured(cases: list[Case], columns: tuple[str, ...]) -> Iterator[Row]:
    """A row for each case and column; what is measured is kept at once."""
    known = {(row.case, row.kernel): row for row in kept_rows()}
    for case, column in product(cases, columns):
        if (case, column) not in known:
            row = known[case, column] = measure(case, column)
            with KEPT.open("a") as file:
                file.write(json.dumps(asdict(row)) + "\n")
        yield known[case, column]


def kept_rows() -> Iterator[Row]:
    for line in KEPT.read_text().splitlines() if KEPT.exists() else []:
        fields = json.loads(line)
        yield Row(**fields | {"case": Case(**fields["case"])})


def measure(case: Case, kernel: str) -> Row:
    """Let a kernel map the case, or draw it at the true poses."""
    robot = case.robot()
    if kernel in (TRUE, EXACT, EVERY):
        trajectory, grid = drawn(robot, exact=kernel == EXACT, apart=0.0 if kernel == EVERY else APART)
    else:
        slam = create(kernel, {}, case.seed)
        for seq, sweep in enumerate(robot.sweeps()):
            slam.process(pack(sweep, "robot", "0" * 32, seq))
        slam.finish()
        trajectory, grid = slam.trajectory(), slam.map()
    truth = np.column_stack([trajectory[:, 0], robot.poses(trajectory[:, 0])])
    error, (pose, _, _) = absolute_error([trajectory], [truth]), fit_all([trajectory], [truth])
    occupancy, (x0, y0) = grid.occupancy()
    walls = truth_of(replace(case, sensors="wheels+imu", noise="good"))
    score = score_occupancy(
        occupancy, grid.resolution, walls, origin=(x0 * grid.resolution, y0 * grid.resolution, 0.0), pose=pose
    )
    return Row(case, kernel, error.rmse, error.max, score.iou, score.precision, score.recall, wall_thickness(occupancy))


@cache
def truth_of(case: Case) -> NDArray[np.float64]:
    """Points (n, 2) on the walls that the case's robot could see: no sensor but the laser matters."""
    robot = case.robot()
    return visible_walls(robot.scene, [robot], CELL_M)


def drawn(robot: SimulatedRobot, exact: bool, apart: float) -> tuple[NDArray[np.float64], Grid]:
    """The true trajectory (n, 4) from where the robot started, as kernels have it, and the map of scans drawn there.

    `apart` in m or rad is how far the robot moves between two scans that are drawn.
    """
    canvas, grid = Canvas(CELL_M), Grid(CELL_M)
    rows: list[list[float]] = []
    last = start = robot.pose(0.0)
    for sweep in robot.sweeps():
        pose = between(start, robot.pose(sweep.stamp))
        rows.append([sweep.stamp, *pose])
        if len(rows) > 1:
            moved = between(last, pose)
            if max(np.hypot(moved[0], moved[1]), abs(moved[2])) < apart:
                continue
        last = pose
        points, beams = ends(robot, sweep, exact)
        laser = np.array(robot.lidar.geometry.mount[:2])
        met, joined = walls(points, beams, laser)
        canvas.draw(pose, met, laser, joined=joined)
    canvas.publish(grid)
    return np.array(rows), grid


def ends(robot: SimulatedRobot, sweep: Sweep, exact: bool) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Ends (n, 2) of the sweep's beams in the base frame at its stamp, each from where the laser was at its time.

    With them the beams' indices (n,).
    """
    seen = np.flatnonzero(np.isfinite(sweep.ranges))
    ranges = true_ranges(robot.scene.world, robot.lidar, robot.track, sweep.stamp, []) if exact else sweep.ranges
    laser = compose(robot.track.turned(sweep.stamp + robot.lidar.offsets()), robot.lidar.geometry.mount)[seen]
    bearing = laser[:, 2] + robot.lidar.angles()[seen]
    reach = ranges[seen, None].astype(np.float64)
    world = laser[:, :2] + reach * np.column_stack([np.cos(bearing), np.sin(bearing)])
    kept = np.isfinite(world).all(axis=1)
    return apply(inverse(robot.pose(sweep.stamp)), world[kept]).astype(np.float32), seen[kept].astype(np.int32)


def markdown(rows: list[Row], columns: tuple[str, ...]) -> str:
    """One line a case, all seeds together: RMS error mean (largest error; runs failed), IoU mean (worst)."""
    kernels = [column for column in columns if column in KERNELS]
    heads = ["scene", "laser", "sensors", "noise"]
    heads += [f"{kernel}: {what}" for kernel in kernels for what in ("RMS", "largest", "failed", "IoU", "worst IoU")]
    heads += [f"IoU, {column}" for column in columns if column not in KERNELS]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for key in dict.fromkeys(replace(row.case, seed=0) for row in rows):
        cells = [key.scene, key.lidar, key.sensors, key.noise]
        for column in columns:
            runs = [row for row in rows if row.kernel == column and replace(row.case, seed=0) == key]
            iou = [row.iou for row in runs]
            if column in KERNELS:
                failed = sum(row.most > FAILED_M for row in runs)
                cells += [f"{np.mean([row.rms for row in runs]):.3f}", f"{max(row.most for row in runs):.3f}"]
                cells += [f"{failed}/{len(runs)}", f"{np.mean(iou):.3f}", f"{min(iou):.3f}"]
            else:
                cells.append(f"{np.mean(iou):.3f}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
