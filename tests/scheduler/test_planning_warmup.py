"""After warming up, no plan waits for a compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

FIRST_PLANS = """
import sys
from services.scheduler.warmup import warmup

def compiled():
    return {
        f"{module}.{name}": len(value.signatures)
        for module, content in list(sys.modules.items()) if module.startswith("services.scheduler.")
        for name, value in vars(content).items() if hasattr(value, "signatures") and hasattr(value, "py_func")
    }

warmup()
before = compiled()
from test_plan_host import EDGES, POLICY, robot, two_rooms
from services.scheduler.plan_host import PlanHost
from services.scheduler.policies import POLICIES
many = [robot(f"r{n}", (4.0 * n, 0), f"e{n % 2 + 1}") for n in range(30)]
for policy in POLICIES:
    for robots in (two_rooms(), many):
        PlanHost().plan(robots, EDGES, None, policy, **POLICY)
assert before
print(sorted(name for name, count in compiled().items() if count > before.get(name, count)))
"""


def test_the_first_plan_of_any_policy_compiles_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FIRST_PLANS],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr
