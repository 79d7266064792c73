"""An apartment of 13 x 18 m: living room and kitchen in the south, a corridor north, three rooms on either side.

Two loops lead past the corridor: study - bedroom C in the east, bath - bedroom B in the west.
"""

from __future__ import annotations

from common.sim.scene import Scene
from common.sim.scenes.places import routes_of
from common.sim.world import Plan, Point

PLACES: dict[str, Point] = {
    "L0": (0.9, 1.4), "L1": (1.0, 3.5), "L2": (3.2, 1.4), "L3": (3.3, 3.2), "L4": (5.6, 3.0),
    "Lc": (6.3, 4.7), "Lk": (6.7, 2.4),
    "K1": (8.2, 2.4), "K2": (11.4, 1.4), "K3": (11.5, 4.85), "K4": (8.4, 4.85),
    "C0": (6.2, 6.7), "C1": (6.2, 7.6), "C2": (6.1, 10.2), "C3": (6.1, 11.5), "C4": (6.35, 12.3),
    "C5": (6.3, 15.5), "C6": (6.3, 16.85),
    "A1": (4.7, 7.6), "A2": (2.9, 8.7), "A3": (2.9, 6.2), "A4": (0.95, 8.9),
    "B1": (4.7, 11.5), "B2": (1.4, 11.35), "B3": (1.4, 12.2),
    "D0": (1.4, 13.6), "D1": (4.6, 15.5), "D2": (2.4, 14.8), "D3": (4.3, 17.2),
    "S1": (8.0, 6.8), "S2": (11.5, 6.8), "S3": (11.7, 8.55), "S4": (8.7, 8.55),
    "E0": (11.7, 10.1), "E1": (8.0, 12.3), "E2": (9.8, 12.0), "E3": (8.6, 10.2),
    "U1": (8.0, 16.85), "U2": (10.2, 16.6), "U3": (11.5, 15.2), "U4": (8.0, 14.8),
}  # fmt: skip

ROUTES = {
    "r1": "L1 L0 L2 L4 Lk K1 K2 K3 K4 K1 Lk L4 L3 L4 Lc C0 C1 A1 A2 A4 A2 A1 C1",
    "r2": "C2 C1 A1 A3 A2 A1 C1 C0 S1 S2 S3 E0 E2 E1 C4 C2 C0 Lc L4 L3 L1",
    "r3": "D3 D1 D2 D0 B3 B2 B1 C3 C4 E1 E3 E0 S3 S4 S1 C0 C1 C4 C5 D1",
    "r4": "U3 U2 U1 U4 U1 C6 C5 D1 D3 D1 D2 D1 C5 C4 E1 E2 E0 E3 E1 C4 C3 C2",
    "r5": "K3 K2 K1 K4 K1 Lk Lc C0 S1 S4 S3 E0 E3 E1 C4 C3 B1 B2 B1 C3 C4",
    "r6": "A4 A2 A3 A1 C1 C4 C5 C6 U1 U2 U3 U2 U1 C6 C5 D1 D3 D1 D2",
    "r7": "B2 B3 D0 D2 D1 C5 C6 U1 U4 U1 C6 C5 C4 C2 C1 A1 A2 A1 C1 C0 S1",
    "r8": "E2 E1 C4 C2 C0 Lc L4 L2 L0 L1 L3 L4 Lk K1 K2 K3 K4 K1 Lk Lc C0",
    "r9": "S2 S1 C0 Lc Lk K1 Lk L4 L3 L2 L4 Lc C0 C1 A1 A3 A1 C1 C4 E1 E3",
    "r10": "C6 C4 C1 C0 Lc L4 Lk K1 K4 K1 Lk Lc C0 S1 S2 S3 E0 E2 E1 C4 C5",
}


def build() -> Scene:
    plan = Plan()
    plan.room(0, 0, 13, 18)
    plan.wall((0, 5.5), (5.75, 5.5))
    plan.wall((6.9, 5.5), (13, 5.5))
    plan.wall((7.5, 0), (7.5, 5.5), doors=[(1.5, 3.3)])
    plan.wall((5.5, 5.5), (5.5, 18), doors=[(1.6, 2.6), (5.5, 6.45), (9.5, 10.5)])
    plan.wall((7.1, 5.5), (7.1, 18), doors=[(0.7, 1.7), (6.3, 7.3), (10.85, 11.8)])
    plan.wall((0, 10), (5.5, 10))
    plan.wall((0, 12.8), (5.5, 12.8), doors=[(0.9, 1.9)])
    plan.wall((7.1, 9.2), (13, 9.2), doors=[(4.1, 5.1)])
    plan.wall((7.1, 13.6), (13, 13.6))
    plan.wall((10.2, 13.6), (10.2, 15.6))
    plan.wall((2.7, 11.85), (2.7, 12.8), thickness=0.04)
    for furnish in (_living, _kitchen, _west, _east):
        furnish(plan)
    return Scene("apartment", plan.world(), PLACES["C1"], routes_of(PLACES, ROUTES))


def _living(plan: Plan) -> None:
    plan.box(0.9, 4.5, 2.2, 0.94)  # sofa
    plan.box(1.2, 0.07, 1.8, 0.4)  # television
    plan.box(3.6, 3.9, 0.8, 0.8, turn=0.5)  # armchair
    plan.box(1.5, 2.3, 1.0, 0.6, turn=0.15)  # low table
    plan.column(0.45, 0.45, 0.2)  # plant
    plan.box(0.07, 1.8, 0.35, 1.2)  # bookcase
    plan.box(5.0, 1.2, 0.35, 0.35)  # pillar


def _kitchen(plan: Plan) -> None:
    plan.box(12.3, 0.07, 0.64, 3.6)  # counter
    plan.box(9.2, 0.07, 3.1, 0.6)
    plan.box(12.22, 4.3, 0.7, 0.8)  # fridge
    for x, y in ((9.4, 3.4), (10.6, 3.4), (9.4, 4.2), (10.6, 4.2)):
        plan.column(x, y, 0.05, corners=8)  # legs of the dining table
    plan.box(9.8, 2.9, 0.4, 0.4, turn=0.3)  # chairs
    plan.box(9.55, 3.65, 0.38, 0.38, turn=-0.2)


def _west(plan: Plan) -> None:
    plan.box(6.68, 9.7, 0.36, 0.9)  # corridor: cabinet and shoes
    plan.box(5.56, 13.2, 0.3, 0.8)
    plan.box(0.07, 6.4, 2.0, 1.6)  # bedroom A
    plan.box(0.07, 8.15, 0.45, 0.4)
    plan.box(1.0, 9.41, 2.2, 0.53)
    plan.box(4.0, 5.56, 1.3, 0.6)
    plan.column(4.6, 6.5, 0.22)
    plan.box(0.07, 10.06, 1.7, 0.75)  # bath
    plan.box(2.6, 10.06, 0.45, 0.65)
    plan.box(3.6, 12.2, 0.7, 0.54)
    plan.box(4.7, 10.06, 0.65, 0.65)
    plan.box(1.6, 16.0, 1.8, 1.93)  # bedroom B
    plan.box(1.1, 17.5, 0.45, 0.43)
    plan.box(3.6, 12.86, 1.8, 0.6)
    plan.box(0.07, 14.6, 0.6, 1.3)
    plan.column(1.0, 15.25, 0.2)
    plan.box(5.0, 17.5, 0.44, 0.43)


def _east(plan: Plan) -> None:
    plan.box(9.2, 5.56, 1.6, 0.7)  # study
    plan.box(12.6, 6.4, 0.33, 1.8)
    plan.column(10.2, 7.7, 0.45)
    plan.box(7.16, 8.3, 0.5, 0.84)
    plan.box(11.0, 11.7, 1.93, 1.5)  # bedroom C
    plan.box(7.16, 9.26, 0.6, 1.7)
    plan.box(9.0, 13.0, 1.2, 0.54)
    plan.box(12.5, 11.2, 0.43, 0.45)
    plan.column(10.6, 13.3, 0.12)
    plan.column(12.3, 17.3, 0.35)  # store room
    plan.box(7.16, 13.66, 2.2, 0.4)
    plan.box(8.75, 15.05, 0.5, 0.7, turn=0.4)
    plan.box(10.9, 13.66, 1.6, 0.6)
    plan.box(12.3, 15.0, 0.63, 0.9)
