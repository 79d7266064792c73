"""An office floor of about 150 x 100 m, made from a seed: nested loops of corridors that look alike.

The route `r1` is 1.5 km long. Rooms differ, but from a corridor little is seen of them, as in real offices.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from common.sim.scene import Scene
from common.sim.scenes.lattice import Lattice
from common.sim.world import Plan

WIDTH, HEIGHT = 150.0, 100.0
CORRIDOR = 2.4
"""m, wall to wall"""
DOOR = 1.0
DOORS_OPEN = 0.6
"""share of the rooms whose door stands open"""
ROUTE_M = 1500.0


def build(seed: int = 0) -> Scene:
    """The office of this seed; `office` and `office:0` are one."""
    rng = np.random.default_rng([150, 100, seed])
    xs = np.array([1.5, 31.0, 60.5, 90.0, 119.5, WIDTH - 1.5])
    ys = np.array([1.5, 34.0, 66.0, HEIGHT - 1.5])
    xs[1:-1] += rng.uniform(-3, 3, size=len(xs) - 2)
    ys[1:-1] += rng.uniform(-3, 3, size=len(ys) - 2)
    corridors = Lattice(tuple(xs.tolist()), tuple(ys.tolist()))
    plan, half = Plan(), CORRIDOR / 2
    plan.room(xs[0] - half, ys[0] - half, xs[-1] + half, ys[-1] + half, thickness=0.3)
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            _block(plan, x0 + half, y0 + half, x1 - half, y1 - half, rng)
    routes = {f"r{n + 1}": corridors.stroll(start, ROUTE_M if n == 0 else 400.0, rng) for n, start in enumerate(
        [(0, 0), (5, 3), (2, 1), (3, 2), (0, 3), (5, 0)]
    )}  # fmt: skip
    name = "office" if seed == 0 else f"office:{seed}"
    return Scene(name, plan.world(), corridors.point((2, 1)), routes)


def _block(plan: Plan, x0: float, y0: float, x1: float, y1: float, rng: np.random.Generator) -> None:
    """Two rows of rooms, doors to the corridors south and north, back to back; open ends east and west are walled."""
    middle = (y0 + y1) / 2 + rng.uniform(-2, 2)
    plan.wall((x0, middle), (x1, middle))
    for low, high, front in ((y0, middle, y0), (middle, y1, y1)):
        cuts = [x0]
        while x1 - cuts[-1] > 8.5:
            cuts.append(cuts[-1] + rng.uniform(3.5, 6.5))
        cuts.append(x1)
        doors = []
        for left, right in pairwise(cuts):
            if rng.random() < DOORS_OPEN:
                at = rng.uniform(left + 0.5, right - 0.5 - DOOR) - x0
                doors.append((at, at + DOOR))
            _furnish(plan, left, low, right, high, rng)
        plan.wall((x0, front), (x1, front), doors=doors)
        for cut in cuts:
            plan.wall((cut, low), (cut, high))
    _niches(plan, x0, y0, x1, y1, rng)


def _furnish(plan: Plan, x0: float, y0: float, x1: float, y1: float, rng: np.random.Generator) -> None:
    """A desk and a cupboard somewhere, 1.5 m or more off the doors' walls."""
    width, depth = rng.uniform(1.2, 1.8), rng.uniform(0.6, 0.9)
    plan.box(rng.uniform(x0 + 0.2, x1 - 0.2 - width), rng.uniform(y0 + 2.0, y1 - 2.0 - depth), width, depth)
    plan.box(x0 + 0.1, rng.uniform(y0 + 2.0, y1 - 3.5), 0.45, rng.uniform(0.8, 1.5))


def _niches(plan: Plan, x0: float, y0: float, x1: float, y1: float, rng: np.random.Generator) -> None:
    """A few shallow things along the corridors' walls: extinguishers, cabinets, radiators."""
    for _ in range(rng.integers(2, 5)):
        length, deep = rng.uniform(0.3, 1.2), rng.uniform(0.12, 0.35)
        x, y = rng.uniform(x0 + 1, x1 - 2), rng.uniform(y0 + 1, y1 - 2)
        side = rng.integers(4)
        if side == 0:
            plan.box(x, y0 - deep, length, deep)
        elif side == 1:
            plan.box(x, y1, length, deep)
        elif side == 2:
            plan.box(x0 - deep, y, deep, length)
        else:
            plan.box(x1, y, deep, length)
