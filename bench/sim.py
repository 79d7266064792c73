"""How fast simulated robots make sweeps, and how far their odometry drifts.

    python -m bench.sim

CPU time of one process; the simulator should never be what a run waits for.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from common.geometry import between
from common.sim.odometry import PRESETS, wheel_odometry
from common.sim.robot import SimulatedRobot
from common.sim.scene import load_scene

RUNS = [
    ("apartment", "lds01", 0), ("apartment", "sick", 0), ("apartment", "rplidar_a1", 0), ("apartment", "rplidar_a1", 3),
    ("apartment", "rplidar_a1", 9), ("factory", "rplidar_a1", 11), ("office", "rplidar_a1", 0), ("office", "sick", 0),
]  # fmt: skip
SECONDS = 120.0
DRAWS = 50
OUT = Path("results/sim.json")


def speed(scene: str, lidar: str, peers: int) -> float:
    """Sweeps a CPU second of robot r1 among `peers` others, compilation and first ray left out."""
    seen = [f"r{number + 2}" for number in range(peers)]
    robot = SimulatedRobot(load_scene(scene), "r1", 1, lidar=lidar, duration_s=SECONDS, peers=seen)
    next(iter(robot.sweeps()))
    begin = time.process_time()
    count = sum(1 for _ in robot.sweeps())
    return count / (time.process_time() - begin)


def drift(preset: str) -> float:
    """Mean error in metres of raw odometry at the end of the apartment's r1, over many robots."""
    track = SimulatedRobot(load_scene("apartment"), "r1", 0).track
    errors = []
    for seed in range(DRAWS):
        rows = wheel_odometry(track, track.duration, PRESETS[preset], np.random.default_rng(seed))
        true = between(track.at([0.0])[0], track.at(rows[-1:, 0])[0])
        errors.append(float(np.hypot(*(rows[-1, 1:3] - true[:2]))))
    return float(np.mean(errors))


def main() -> None:
    speeds = [(scene, lidar, peers, round(speed(scene, lidar, peers))) for scene, lidar, peers in RUNS]
    drifts = {preset: round(drift(preset), 2) for preset in PRESETS}
    for scene, lidar, peers, rate in speeds:
        print(f"{scene:10s} {lidar:11s} {peers:2d} peers {rate:6d} sweeps/s")
    for preset, error in drifts.items():
        print(f"odometry {preset:9s} {error:6.2f} m off after 46 m")
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps({"sweeps_per_s": speeds, "drift_m": drifts}, indent=1))


if __name__ == "__main__":
    main()
