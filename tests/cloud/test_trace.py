"""The trace of a global map: Eqs. 1-3."""

from __future__ import annotations

import pytest
from cloud_samples import STREAM, cover, edge_notice, map_notice

from common.wire import RobotStatus
from services.cloud_merger.trace import trace


def status(robot: str, pack_s: float) -> RobotStatus:
    return RobotStatus(
        robot=robot,
        stream=STREAM,
        sent=1,
        processed=0,
        spooled=1,
        spool_bytes=1,
        dropped=0,
        backfilled=0,
        pack_s=pack_s,
    )


def test_the_total_is_the_slowest_path_and_the_clouds_time() -> None:
    edges = {
        "e1": edge_notice("e1", 1, 1, {"r1": cover(9), "r2": cover(9)}).model_copy(
            update={"fuse_s": 0.2, "transfer_s": 0.1}
        ),
        "e2": edge_notice("e2", 1, 1, {"r3": cover(9)}).model_copy(update={"fuse_s": 0.1}),
    }
    maps = {r: map_notice(r, "e1", 9).model_copy(update={"slam_s": s}) for r, s in (("r1", 1.0), ("r2", 3.0))}
    made = trace(edges, edges, maps, {"r2": status("r2", 0.05)}, {"e1": 0.3, "e2": 0.0}, fuse_s=0.5)
    assert made.robots["r2"].slam == pytest.approx(0.3)
    assert made.total_s == pytest.approx(0.05 + 0.3 + 0.1 + 0.3 + 0.2 + 0.5)
    assert made.critical == ("r2", "e1", "cloud")


def test_what_has_not_been_measured_counts_as_nothing() -> None:
    made = trace(["e1"], {"e1": edge_notice("e1", 1, 1, {"r1": cover(-1)})}, {}, {}, {}, fuse_s=0.0)
    assert (made.total_s, made.critical) == (0.0, ("r1", "e1", "cloud"))
