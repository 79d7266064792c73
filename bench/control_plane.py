"""The scheduler's control plane on 10 to 5000 synthetic robots: time of an event, time of a plan, memory.

Run: python -m bench.control_plane [--robots N ...]. State machine, measurements and planner run in this process, in
virtual time; no sketches and no bus. Writes results/control_plane.json.
"""

from __future__ import annotations

import argparse
import resource
import time
from typing import Any

import numpy as np

from bench.results import append, show
from bench.synthetic_cluster import SyntheticCluster

SECONDS = 9
"""virtual; three plans"""


def measure(robots: int, edges: int, policy: str, budget_s: float) -> dict[str, Any]:
    cluster = SyntheticCluster(robots, edges, policy=policy, budget_s=budget_s, noise=0.1)
    begin = time.process_time()
    cluster.start()
    coming = time.process_time() - begin
    cluster.event_s.clear()
    cluster.run(SECONDS)
    cluster.state.validate()
    events = np.array(cluster.event_s)
    return {
        "policy": policy,
        "robots": robots,
        "edges": edges,
        "all come s": coming,
        "event us (median)": 1e6 * float(np.median(events)),
        "event ms (worst)": 1e3 * float(events.max()),
        "plan s (median)": float(np.median(cluster.plan_s)),
        "tables": len(cluster.tables),
        "peak MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="*", default=[10, 50, 200, 1000, 5000])
    parser.add_argument("--policy", action="append", help="may be given again (default: paper, recslam)")
    parser.add_argument("--budget-s", type=float, default=0.5)
    options = parser.parse_args()
    SyntheticCluster(6, 2).start()
    measure(6, 2, "recslam", 0.1)
    rows = []
    for robots in options.robots:
        for policy in options.policy or ("paper", "recslam"):
            rows.append(measure(robots, max(3, robots // 25), policy, options.budget_s))
            show(rows[-1:])
    print(f"written to {append('control_plane', {'rows': rows})}")


if __name__ == "__main__":
    main()
