"""Graph SLAM in big buildings that look alike, with bad wheels: every accepted loop is held against the truth.

    python -m bench.slam_closures [--seeds 10 | --seed 4 --seed 10] [--lidar rplidar_a1|sick] [--noise hostile]
        [--sensors wheels|all] [--bitmap FILE --width METRES]

Each seed is another office floor of 150 x 100 m with 1.5 km of route, and another robot; or, in a world drawn as a
bitmap so many metres wide, a random walk of four minutes. A loop is wrong where it is off by more than `WRONG_M` and
three of its own standard deviations in a direction, or by more than `WRONG_RAD`: one that slid along a corridor and
says so is not. CPU time throughout.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.evaluation.trajectory import absolute_error
from common.geometry import between
from common.geometry.pose_graph import PoseGraph
from common.sim import SimulatedRobot, load_scene
from common.sim.bitmap import load_bitmap
from common.sim.scene import Scene
from services.edge_worker.slam.graph.graph_slam import GraphSlam
from services.edge_worker.slam.graph.keyframe import Keyframe
from services.edge_worker.slam.graph.loop import Loop
from services.edge_worker.slam.graph.loop_closer import LoopCloser
from services.edge_worker.slam.warmup import warmup
from services.robot_agent.packing import pack

WRONG_M, WRONG_RAD = 0.2, 0.05
SPEED_MPS = 1.0
WALK_MPS, WALK_S = 0.6, 240.0
OUT = Path("results/slam_closures.json")


@dataclass
class JudgedCloser(LoopCloser):
    """A loop closer that remembers how far its loops are off."""

    truth: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) where the robot is"""
    poses: dict[int, tuple[Keyframe, NDArray[np.float64]]] = field(default_factory=dict)
    """by identity, keyframes and where they were taken"""
    errors: list[tuple[float, float, bool]] = field(default_factory=list)
    """m, rad, wrong; of each loop"""

    def look(self, graph: PoseGraph, keyframes: list[Keyframe]) -> list[Loop]:
        self.poses[id(keyframes[-1])] = (keyframes[-1], self.truth)
        return self._judge(super().look(graph, keyframes), keyframes)

    def look_back(self, graph: PoseGraph, keyframes: list[Keyframe]) -> list[Loop]:
        return self._judge(super().look_back(graph, keyframes), keyframes)

    def _judge(self, loops: list[Loop], keyframes: list[Keyframe]) -> list[Loop]:
        for loop in loops:
            a, b = (self.poses[id(keyframes[k])][1] for k in (loop.anchor, loop.keyframe))
            self.errors.append(judged(between(between(a, b), loop.measured), loop.information))
        return loops


def judged(off: NDArray[np.float64], information: NDArray[np.float64]) -> tuple[float, float, bool]:
    """Metres and radians by which a loop is off (3,), and whether that is more than it may be."""
    variances, axes = np.linalg.eigh(np.linalg.inv(information)[:2, :2])
    slid = np.abs(axes.T @ off[:2]) > WRONG_M + 3 * np.sqrt(variances)
    return float(np.hypot(off[0], off[1])), abs(float(off[2])), bool(slid.any() or abs(off[2]) > WRONG_RAD)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="offices 1 to SEEDS")
    parser.add_argument("--seed", type=int, action="append", help="this office only; may be given several times")
    parser.add_argument("--lidar", default="rplidar_a1")
    parser.add_argument("--noise", default="hostile")
    parser.add_argument("--sensors", choices=["wheels", "all"], default="wheels", help="`all`: a gyro, too")
    parser.add_argument("--bitmap", type=Path, help="a world as a picture instead of offices")
    parser.add_argument("--width", type=float, help="its width, m")
    arguments = parser.parse_args()
    if (arguments.bitmap is None) != (arguments.width is None):
        parser.error("--bitmap and --width go together")
    warmup()
    rows = []
    for row in runs(arguments):
        rows.append(row)
        print(line(row), flush=True)
    mean = sum(row["mean_m"] for row in rows) / len(rows)
    print(f"{len(rows)} seeds: error {mean:.3f} m mean, {sum(row['wrong'] for row in rows)} wrong loops")
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(rows, indent=1))


def runs(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for seed in arguments.seed or range(1, arguments.seeds + 1):
        told: dict[str, Any] = {
            "lidar": arguments.lidar,
            "noise": arguments.noise,
            "imu": arguments.sensors == "all",
        }
        if arguments.bitmap is None:
            robot = SimulatedRobot(load_scene(f"office:{seed}"), "r1", seed, speed_mps=SPEED_MPS, **told)
        else:
            world = pictured(arguments.bitmap, arguments.width)
            robot = SimulatedRobot(world, f"w{seed}", seed, speed_mps=WALK_MPS, duration_s=WALK_S, **told)
        yield {"world": robot.scene.name, "seed": seed, **told, **drive(robot)}


def pictured(path: Path, width: float) -> Scene:
    """A bitmap as a world `width` m wide, walled in at its edge."""
    world, start = load_bitmap(path, width, border=True)
    return Scene(path.name.partition(".")[0], world, start)


def drive(robot: SimulatedRobot) -> dict[str, Any]:
    """One robot's whole route."""
    kernel, spent, frames = GraphSlam.create({}, 0), 0.0, 0
    closer = kernel.closer = JudgedCloser(kernel.settings)
    for sweep in robot.sweeps():
        frame = pack(sweep, robot.robot, "0" * 32, frames)
        closer.truth = robot.pose(sweep.stamp)
        begin = time.process_time()
        kernel.process(frame)
        spent += time.process_time() - begin
        if not frames:
            closer.poses[id(kernel.keyframes[0])] = (kernel.keyframes[0], closer.truth)
        frames += 1
    kernel.finish()
    rows = kernel.trajectory()
    error = absolute_error([rows], [np.column_stack([rows[:, 0], robot.poses(rows[:, 0])])])
    off = np.array(closer.errors).reshape(-1, 3)
    return {
        "frames": frames,
        "frames_per_s": frames / spent,
        "mean_m": error.mean,
        "rmse_m": error.rmse,
        "max_m": error.max,
        "degrees": float(np.degrees(error.rotation_mean)),
        "loops": len(off),
        "wrong": int(off[:, 2].sum()),
        "loop_m": np.percentile(off[:, 0], [50, 95, 100]).tolist() if len(off) else [],
        "scale": kernel.reader.reckoning.wheels.scale,
    }


def line(row: dict[str, Any]) -> str:
    loop_m = " / ".join(f"{m:.3f}" for m in row["loop_m"]) or "-"
    return (
        f"{row['world']} seed {row['seed']} {row['lidar']} {row['noise']}  "
        f"{row['frames']} frames {row['frames_per_s']:.0f}/s  "
        f"error {row['mean_m']:.3f} m mean {row['rmse_m']:.3f} rms {row['max_m']:.3f} max {row['degrees']:.2f} deg  "
        f"loops {row['loops']} off {loop_m} m (p50 / p95 / max), {row['wrong']} wrong"
    )


if __name__ == "__main__":
    main()
