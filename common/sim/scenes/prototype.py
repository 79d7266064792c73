"""A testbed of 6 x 5.5 m set up from panels within a conference room; beams escape through the gaps between them.

Three robots drive up on the left, in the centre and on the right, and meet at the bottom.
"""

from __future__ import annotations

from common.sim.scene import Scene
from common.sim.scenes.places import routes_of
from common.sim.world import Plan, Point

PLACES: dict[str, Point] = {
    "la": (0.6, 0.6), "lb": (0.65, 2.3), "lc": (0.7, 3.5), "ld": (0.7, 4.9), "le": (1.6, 4.7), "lf": (1.7, 0.8),
    "lg": (1.75, 3.3),
    "ca": (2.9, 0.6), "cb": (2.9, 1.7), "cc": (2.3, 2.7), "cd": (2.7, 3.5), "ce": (2.9, 4.9), "cf": (3.6, 4.6),
    "cg": (3.7, 2.7),
    "ra": (5.4, 0.6), "rb": (5.4, 2.0), "rc": (5.3, 3.4), "rd": (5.3, 4.9), "re": (4.4, 4.8), "rf": (4.2, 0.7),
    "rg": (4.4, 2.6),
}  # fmt: skip

ROUTES = {
    "left": "lf la lb lc ld le ld lc lg lc lb la lf ca lf",
    "centre": "ca lf ca rf ca cb cc cd ce cf cd cc cb cg cb",
    "right": "rf ra rb rc rd re rd rc rg rb ra rf ca rf",
}

PANELS_X = [(0.0, 1.12), (1.25, 2.48), (2.6, 3.65), (3.85, 4.88), (5.02, 6.0)]
PANELS_Y = [(0.1, 1.28), (1.4, 2.5), (2.7, 3.85), (4.0, 5.4)]


def build() -> Scene:
    plan = Plan()
    plan.room(-1.4, -1.0, 8.1, 7.2)
    for low, high in PANELS_X:
        plan.wall((low, 0.0), (high, 0.0), thickness=0.05)
        plan.wall((6 - high + 0.03, 5.5), (6 - low - 0.02, 5.53), thickness=0.05)
    for low, high in PANELS_Y:
        plan.wall((0.0, low), (0.02, high), thickness=0.05)
        plan.wall((6.0, 5.5 - high), (5.98, 5.5 - low), thickness=0.05)
    plan.wall((1.2, 1.5), (1.2, 2.8), thickness=0.05)
    plan.wall((1.2, 4.0), (2.2, 4.0), thickness=0.05)
    plan.wall((2.3, 5.5), (2.3, 4.6), thickness=0.05)
    plan.wall((4.0, 3.4), (4.8, 3.4), thickness=0.05)
    plan.wall((4.8, 3.4), (4.8, 4.2), thickness=0.05)
    plan.wall((4.9, 1.1), (3.9, 1.3), thickness=0.05)
    plan.box(1.9, 1.6, 0.4, 0.3, turn=0.3)
    plan.box(2.85, 2.45, 0.35, 0.5)
    plan.box(0.1, 2.75, 0.2, 0.3)
    plan.column(3.9, 5.2, 0.15)
    plan.column(3.45, 3.6, 0.12)
    plan.column(4.65, 1.75, 0.15)
    return Scene("prototype", plan.world(), PLACES["ca"], routes_of(PLACES, ROUTES))
