"""A SLAM host that goes on from a snapshot shows the map of one that was never disturbed."""

from __future__ import annotations

from itertools import islice
from typing import Any

import pytest

from common.grid import Grid
from common.grid.tiles import decode_counts
from common.sim import SimulatedRobot, load_scene
from common.wire import Frame, encode
from services.edge_worker.slam.host import SlamHost
from services.robot_agent.packing import pack

FRAMES, MIDDLE = 120, 70


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    robot = SimulatedRobot(load_scene("two_rooms"), "r1", 1, lidar="lds01", speed_mps=0.5, duration_s=30.0)
    sweeps = islice(robot.sweeps(), FRAMES)
    return [pack(sweep, "r1", "a" * 32, seq, "lds01") for seq, sweep in enumerate(sweeps)]


def opened(kernel: str, life: int, snapshot: bytes | None = None) -> SlamHost:
    host = SlamHost()
    host.open("r1", life, kernel, {}, seed=3, snapshot=snapshot)
    return host


def take(host: SlamHost, frames: list[Frame]) -> None:
    for frame in frames:
        host.process("r1", encode(frame))


def shown(host: SlamHost) -> tuple[str, dict[str, Any]]:
    """Digest of the map that the host shows, and what it tells of it."""
    page = host.tiles("r1", "counts", 0, "", 1 << 26)
    grid = Grid(page["resolution"])
    grid.replace([((x, y), decode_counts(data, "r1")) for x, y, _, data in page["tiles"]])
    return grid.digest(), {name: page[name] for name in ("seq", "final")}


@pytest.mark.parametrize("kernel", ["graph", "gmapping"])
def test_a_stream_that_goes_on_after_its_end_was_told_makes_the_map_of_one_that_never_ended(
    kernel: str, frames: list[Frame]
) -> None:
    whole = opened(kernel, 1)
    take(whole, frames)
    whole.finish("r1")
    early = opened(kernel, 2)
    take(early, frames[:MIDDLE])
    snapshot = early.snapshot("r1")
    early.finish("r1")
    again = opened(kernel, 3, snapshot)
    assert shown(again)[1] == {"seq": MIDDLE - 1, "final": False}
    take(again, frames[MIDDLE:])
    again.finish("r1")
    assert shown(again) == shown(whole)


def test_a_map_whose_last_refinement_is_set_aside_is_final_as_it_is(frames: list[Frame]) -> None:
    host = opened("graph", 1)
    take(host, frames[:10])
    before, _ = shown(host)
    host.finish("r1", refine=False)
    assert shown(host) == (before, {"seq": 9, "final": True})


def test_the_time_spent_before_a_snapshot_counts(frames: list[Frame]) -> None:
    host = opened("graph", 1)
    take(host, frames[:10])
    spent = host.news("r1")["slam_s"]
    assert opened("graph", 2, host.snapshot("r1")).news("r1")["slam_s"] == spent > 0
