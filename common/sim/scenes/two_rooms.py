"""Two big rooms that look nothing alike, joined by a corridor with two bends, so that nobody sees across.

r1 and r2 stay in the west room and r3 and r4 in the east one, so nothing joins the pairs until r5 crosses over.
"""

from __future__ import annotations

from itertools import pairwise

from common.sim.scene import Scene
from common.sim.scenes.places import routes_of
from common.sim.world import Plan, Point

PLACES: dict[str, Point] = {
    "w1": (1.0, 1.0), "w2": (4.2, 1.1), "w3": (7.6, 1.2), "w4": (8.2, 4.0), "w5": (7.6, 6.3), "w6": (4.0, 6.2),
    "w7": (0.9, 6.0), "w8": (1.2, 3.6), "w9": (5.0, 3.9),
    "door": (9.7, 4.05), "bend": (11.25, 4.05), "turn": (11.25, 7.35), "gate": (12.6, 7.35), "e0": (14.0, 7.4),
    "e1": (14.0, 4.2), "e2": (14.0, 1.0), "e3": (17.5, 1.1), "e4": (20.9, 1.2), "e5": (21.0, 5.0), "e6": (20.8, 9.0),
    "e7": (17.4, 8.9), "e8": (13.8, 8.8), "e9": (17.0, 4.6),
}  # fmt: skip

ROUTES = {
    "r1": "w8 w1 w2 w3 w4 w9 w8 w7 w6 w9 w2 w1 w8",
    "r2": "w5 w6 w7 w8 w9 w4 w5 w6 w9 w2 w3 w4",
    "r3": "e2 e3 e4 e5 e9 e1 e2 e3 e9 e5 e4",
    "r4": "e8 e7 e6 e5 e9 e1 e8 e7 e9 e1",
    "r5": "w7 w8 w9 w4 door bend turn gate e0 e1 e9 e5 e6 e7 e8 e0 gate turn bend",
}


def build() -> Scene:
    plan = Plan()
    plan.wall((0, 0), (9, 0), thickness=0.15)
    plan.wall((9, 0), (9, 7.2), doors=[(3.35, 4.75)], thickness=0.15)
    plan.wall((9, 7.2), (0, 7.2), thickness=0.15)
    plan.wall((0, 7.2), (0, 0), thickness=0.15)
    south, north = [(9, 3.3), (12, 3.3), (12, 6.6), (13, 6.6)], [(9, 4.8), (10.5, 4.8), (10.5, 8.1), (13, 8.1)]
    for bends in (south, north):
        for start, end in pairwise(bends):
            plan.wall(start, end, thickness=0.1)
    plan.wall((13, 0), (22, 0), thickness=0.15)
    plan.wall((22, 0), (22, 10), thickness=0.15)
    plan.wall((22, 10), (13, 10), thickness=0.15)
    plan.wall((13, 10), (13, 0), doors=[(1.95, 3.35)], thickness=0.15)
    _west(plan)
    _east(plan)
    return Scene("two_rooms", plan.world(), PLACES["w9"], routes_of(PLACES, ROUTES))


def _west(plan: Plan) -> None:
    """A meeting room: a long table, chairs, cupboards."""
    plan.box(2.3, 2.2, 1.9, 0.9, turn=0.1)
    plan.box(2.2, 4.4, 1.1, 1.0)
    plan.column(6.4, 2.5, 0.3)
    plan.box(5.6, 4.8, 1.2, 0.6, turn=-0.4)
    plan.box(0.08, 1.6, 0.4, 1.4)
    plan.box(5.0, 0.08, 1.6, 0.45)
    plan.box(1.8, 6.72, 1.2, 0.4)
    plan.box(8.5, 1.9, 0.42, 0.8)
    plan.wall((5.8, 7.2), (5.8, 6.75), thickness=0.3)


def _east(plan: Plan) -> None:
    """A workshop: pillars of unlike size, benches, a partition."""
    plan.box(15.3, 2.2, 0.5, 0.5)
    plan.box(19.0, 2.3, 0.7, 0.4)
    plan.box(15.2, 6.3, 0.9, 0.9, turn=0.78)
    plan.column(18.9, 6.6, 0.45)
    plan.wall((18.6, 3.2), (19.9, 3.2), thickness=0.12)
    plan.wall((19.9, 3.2), (19.9, 3.9), thickness=0.12)
    plan.box(15.0, 0.08, 1.6, 0.45)
    plan.box(18.6, 9.3, 1.1, 0.62)
    plan.box(15.0, 9.5, 1.5, 0.42)
    plan.box(21.4, 6.2, 0.52, 1.7)
    plan.box(13.08, 2.1, 0.4, 1.2)
    plan.column(19.3, 5.7, 0.1)
