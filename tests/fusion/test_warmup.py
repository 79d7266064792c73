"""After warming up, no merge waits for a compiler."""

from __future__ import annotations

from pathlib import Path

from compiling import compiled_after

FIRST_MERGE = """
import numpy as np
from drawn_worlds import apartment, mapped
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
"""


def test_the_first_merge_compiles_nothing() -> None:
    assert compiled_after("common.fusion.warmup", "common", FIRST_MERGE, Path(__file__).parent) == "[]"
