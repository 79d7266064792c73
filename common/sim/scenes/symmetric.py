"""A square of 4 x 4 m that looks the same after half a turn: the hard case for whoever matches maps.

Without the start poses nobody can tell a map of it from the same map turned by 180 degrees.
"""

from __future__ import annotations

import numpy as np

from common.sim.scene import Scene
from common.sim.world import Plan

SIDE = 4.0
LOOP = [
    (0.5, 0.55), (1.5, 0.55), (1.5, 1.6), (2.5, 2.4), (3.45, 2.4), (2.5, 2.4),
    (2.5, 1.5), (3.45, 1.5), (2.5, 1.5), (1.5, 1.6), (0.5, 1.5),
]  # fmt: skip
ACROSS = [
    (0.5, 3.4), (0.5, 2.5), (1.5, 2.4), (1.5, 3.4), (1.5, 2.4), (2.5, 2.4),
    (2.5, 1.5), (2.5, 0.6), (2.5, 1.5), (1.5, 1.6), (0.5, 1.5), (0.5, 0.55), (1.5, 0.55),
]  # fmt: skip


def build() -> Scene:
    plan = Plan()
    plan.room(0, 0, SIDE, SIDE)
    plan.wall((2.0, 0.0), (2.0, 1.0), thickness=0.1)
    plan.wall((2.0, 3.0), (2.0, 4.0), thickness=0.1)
    plan.wall((0.0, 2.0), (0.9, 2.0), thickness=0.1)
    plan.wall((3.1, 2.0), (4.0, 2.0), thickness=0.1)
    for x, y in ((1.0, 1.05), (3.0, 1.05), (1.0, 2.95), (3.0, 2.95)):
        plan.box(x - 0.15, y - 0.1, 0.3, 0.2)
    loop, across = np.array(LOOP), np.array(ACROSS)
    routes = {"r1": loop, "r2": SIDE - loop, "r3": across, "r4": SIDE - across}
    return Scene("symmetric", plan.world(), (2.0, 2.0), routes)
