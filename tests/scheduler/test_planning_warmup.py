"""After warming up, no plan waits for a compiler."""

from __future__ import annotations

from pathlib import Path

from compiling import compiled_after

FIRST_PLANS = """
from test_plan_host import EDGES, POLICY, robot, two_rooms
from services.scheduler.plan_host import PlanHost
from services.scheduler.policies import POLICIES
many = [robot(f"r{n}", (4.0 * n, 0), f"e{n % 2 + 1}") for n in range(30)]
for policy in POLICIES:
    for robots in (two_rooms(), many):
        PlanHost().plan(robots, EDGES, None, policy, **POLICY)
"""


def test_the_first_plan_of_any_policy_compiles_nothing() -> None:
    folder = Path(__file__).parent
    assert compiled_after("services.scheduler.warmup", "services.scheduler", FIRST_PLANS, folder) == "[]"
