"""What an edge's fusion process holds stays whole, whatever it is given."""

from __future__ import annotations

import numpy as np
import pytest

from common.errors import Unmergeable
from common.grid.tiles import encode_counts
from services.edge_worker.fusion_host import FusionHost

TILE = encode_counts(np.ones((2, 64, 64), np.uint16))


def put(host: FusionHost, version: int, *tiles: tuple[int, int], whole: bool) -> None:
    host.put("r1", 0.05, version, False, {"seq": version}, [(x, y, TILE) for x, y in tiles], whole)


@pytest.mark.parametrize("whole", [False, True])
def test_a_map_that_is_refused_leaves_the_one_before_to_be_fused(whole: bool) -> None:
    host = FusionHost()
    put(host, 1, (0, 0), whole=True)
    before = host.fuse("e1", ["r1"], None)
    with pytest.raises(Unmergeable, match="too large"):
        put(host, 2, (0, 0), (1000, 1000), whole=whole)
    after = host.fuse("e1", ["r1"], None)
    assert [done["covers"] for done in (before, after)] == [{"r1": {"seq": 1}}] * 2
    assert after["version"] == before["version"]
    put(host, 3, (1, 0), whole=False)
    assert host.fuse("e1", ["r1"], None)["area_m2"] == 2 * before["area_m2"]
