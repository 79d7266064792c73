"""A factory hall of 60 x 40 m: aisles between machines and racks, pillars, and offices in one corner."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from common.sim.scene import Scene
from common.sim.scenes.lattice import Lattice
from common.sim.world import Plan

AISLES = Lattice(xs=(2.5, 11.0, 21.5, 29.5, 41.0, 49.5, 57.5), ys=(2.5, 9.5, 18.5, 26.0, 37.5))
HALF_AISLE = 1.3
"""m kept free on either side of an aisle's middle line"""

ROUTES = {
    "r1": "0-0 2-0 2-1 0-1 0-2 1-2 1-0 3-0 3-1 1-1",
    "r2": "3-0 5-0 5-1 3-1 3-2 4-2 4-0 2-0 2-2 3-2",
    "r3": "6-0 6-2 4-2 4-1 6-1 6-0 4-0 4-1 5-1 5-2",
    "r4": "0-2 0-4 2-4 2-3 0-3 0-2 2-2 2-3 1-3 1-4",
    "r5": "2-2 4-2 4-3 2-3 2-4 4-4 4-3 3-3 3-1 2-1",
    "r6": "6-2 6-3 4-3 4-4 5-4 5-2 4-2 4-3 5-3 6-3 6-1",
    "r7": "1-0 1-3 2-3 2-1 0-1 0-3 1-3 1-4 2-4",
    "r8": "3-4 3-1 4-1 4-3 2-3 2-2 4-2 4-4",
    "r9": "5-0 5-3 6-3 6-1 4-1 4-2 5-2 5-4",
    "r10": "0-1 0-4 2-4 2-2 1-2 1-1 0-1 0-0",
    "r11": "2-0 6-0 6-1 3-1 3-0 4-0 4-1",
    "r12": "5-4 2-4 2-3 5-3 5-2 3-2 3-3",
}


def build() -> Scene:
    plan, rng = Plan(), np.random.default_rng(60_40)
    plan.room(0, 0, 60, 40, thickness=0.3)
    for x0, x1 in pairwise(AISLES.xs):
        for y0, y1 in pairwise(AISLES.ys):
            if (x0, y1) != (49.5, 37.5):
                _block(plan, x0 + HALF_AISLE, y0 + HALF_AISLE, x1 - HALF_AISLE, y1 - HALF_AISLE, rng)
    _offices(plan)
    _edges(plan, rng)
    return Scene(
        "factory", plan.world(), AISLES.point((3, 2)), {name: AISLES.way(told) for name, told in ROUTES.items()}
    )


def _block(plan: Plan, x0: float, y0: float, x1: float, y1: float, rng: np.random.Generator) -> None:
    """Machines, tanks and racks within a rectangle, different in each block."""
    kind = rng.integers(3)
    x = x0 + rng.uniform(0, 0.6)
    while x < x1 - 1.0:
        width = min(rng.uniform(0.9, 3.2), x1 - x)
        low, high = y0 + rng.uniform(0, 1.2), y1 - rng.uniform(0, 1.2)
        if kind == 0:  # racks
            plan.box(x, low, min(width, 1.2), high - low)
            x += min(width, 1.2) + rng.uniform(1.0, 2.0)
        elif kind == 1:  # machines, two deep, with a passage between
            middle = low + (high - low) * rng.uniform(0.3, 0.6)
            plan.box(x, low, width, middle - low)
            plan.box(x + 0.2, middle + rng.uniform(0.8, 1.2), max(0.5, width - 0.6), max(0.5, (high - middle) * 0.5))
            x += width + rng.uniform(0.4, 1.6)
        else:  # tanks and turned machines
            radius = min(width, high - low) / 2 * rng.uniform(0.6, 0.9)
            plan.column(x + width / 2, low + radius + rng.uniform(0, max(0.1, high - low - 2 * radius)), radius)
            reach = min(0.9, (x1 - x) / 2)
            plan.box(x + 0.2, high - reach, reach, reach * 0.6, turn=rng.uniform(0, 0.5))
            x += width + rng.uniform(0.3, 1.2)


def _offices(plan: Plan) -> None:
    """Two rooms with doors in the north-east block."""
    x0, y0, x1, y1 = 50.9, 27.4, 56.1, 36.1
    plan.wall((x0, y0), (x1, y0))
    plan.wall((x1, y0), (x1, y1), doors=[(1.5, 2.5)])
    plan.wall((x1, y1), (x0, y1))
    plan.wall((x0, y1), (x0, y0), doors=[(1.2, 2.2)])
    plan.wall((x0, 31.0), (x1, 31.0))
    plan.box(52.0, 28.2, 1.6, 0.8)
    plan.box(53.5, 33.0, 0.8, 1.8)


def _edges(plan: Plan, rng: np.random.Generator) -> None:
    """Pillars and crates along the outer walls, never twice at one distance."""
    for x in np.cumsum(rng.uniform(2.5, 7.0, size=9)):
        plan.box(float(x), 0.15, rng.uniform(0.3, 1.5), rng.uniform(0.25, 0.7))
    for x in np.cumsum(rng.uniform(2.5, 7.0, size=9)):
        plan.box(float(x), 39.2, rng.uniform(0.3, 1.5), 0.65)
    for y in np.cumsum(rng.uniform(3.0, 6.0, size=6)):
        plan.box(0.15, float(y), rng.uniform(0.25, 0.7), rng.uniform(0.3, 1.5))
    for y in np.cumsum(rng.uniform(3.0, 6.0, size=6)):
        plan.box(59.2, float(y), 0.65, rng.uniform(0.3, 1.5))
