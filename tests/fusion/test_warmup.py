"""After warming up, no merge waits for a compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

FIRST_MERGE = """
import sys
import numpy as np
from drawn_worlds import apartment, mapped
from common.fusion.warmup import warmup

def compiled():
    return {
        f"{module}.{name}": len(value.signatures)
        for module, content in list(sys.modules.items()) if module.startswith("common.")
        for name, value in vars(content).items() if hasattr(value, "signatures") and hasattr(value, "py_func")
    }

warmup()
before = compiled()
from test_bend import WIDTH_M, drifted
from common.fusion.pairs import PairTable, all_pairs
world = apartment(3, width_m=WIDTH_M)
maps = [
    mapped(world, np.array([3.0, 2.0, 0.3]), (0, 30), seed=1),
    mapped(drifted(world, 0.003), np.array([-4.0, 7.0, 2.0]), (8, 40), seed=2),
    mapped(world, np.zeros(3), (0, 20), seed=3),
]
table = PairTable()
for k, map_ in enumerate(maps):
    table.put(f"r{k}", map_, 1, True)
table.decide(all_pairs(table.known))
assert [each.kind for each in table.verdicts.values()] == ["merged"] * 3, table.verdicts
print(sorted(name for name, count in compiled().items() if count > before.get(name, count)))
"""


def test_the_first_merge_compiles_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FIRST_MERGE],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr
