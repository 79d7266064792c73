"""A room of 5 x 5 m whose inner walls and things repeat nowhere."""

from __future__ import annotations

from common.sim.scene import Scene
from common.sim.scenes.places import routes_of
from common.sim.world import Plan, Point

PLACES: dict[str, Point] = {
    "a": (0.6, 0.6), "b": (1.6, 1.3), "c": (0.7, 2.5), "d": (1.8, 2.6), "e": (0.8, 4.2), "f": (2.1, 4.3),
    "g": (2.8, 3.2), "h": (3.6, 4.3), "i": (4.4, 3.4), "j": (3.4, 2.1), "k": (4.4, 1.9), "l": (4.3, 0.7),
    "m": (3.2, 0.7), "n": (2.4, 1.6),
}  # fmt: skip

ROUTES = {
    "r1": "a b n d c d n j k j n b a",
    "r2": "c d f e f d g h i h g d c",
    "r3": "l m l k j g i g j k l m",
    "r4": "h g j n b a b n d f e f d g i",
}


def build() -> Scene:
    plan = Plan()
    plan.room(0, 0, 5, 5)
    plan.wall((0, 1.85), (1.2, 1.85), thickness=0.1)
    plan.wall((2.5, 0), (2.5, 1.05), thickness=0.1)
    plan.wall((1.3, 3.3), (1.3, 3.8), thickness=0.1)
    plan.wall((0, 3.3), (1.3, 3.3), thickness=0.1)
    plan.wall((5, 2.65), (4.0, 2.65), thickness=0.1)
    plan.wall((2.85, 5), (2.85, 4.0), thickness=0.1)
    plan.box(0.07, 1.0, 0.5, 0.78)
    plan.box(1.2, 0.07, 0.9, 0.4)
    plan.box(3.5, 1.15, 0.45, 0.3, turn=0.5)
    plan.box(4.45, 4.3, 0.48, 0.63)
    plan.box(1.35, 4.72, 0.5, 0.2)
    plan.column(2.5, 3.9, 0.16)
    plan.column(3.55, 2.75, 0.12)
    plan.column(0.25, 2.9, 0.15)
    return Scene("asymmetric", plan.world(), PLACES["j"], routes_of(PLACES, ROUTES))
