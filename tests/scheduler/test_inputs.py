"""What is measured: links, speeds of edges, times of fusions; and the file that a machine's profile is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import EdgeConfig, EdgeEntry, Fleet, RobotConfig, RobotEntry, SimSource
from common.errors import ConfigError, UsageError
from common.wire import (
    CloudStatus,
    Cover,
    EdgeMapNotice,
    EdgeStatus,
    InstanceStatus,
    LinkStatus,
    MapNotice,
    RobotProfile,
    RobotStatus,
)
from services.scheduler.costs import FusionModel
from services.scheduler.inputs import ALIKE, FRAME_HZ, NEVER_S, Inputs
from services.scheduler.profile import Profile, load_profile
from services.scheduler.regression import FusionTimes
from services.scheduler.what_if import WhatIf

STREAM = "a" * 32


def fleet(*edges: str) -> Fleet:
    robots = tuple(RobotEntry(id=f"r{n}", source=SimSource(scene="two_rooms")) for n in range(1, 5))
    return Fleet(robots=robots, edges=tuple(EdgeEntry(id=edge) for edge in edges))


def edge_status(edge: str, scans: dict[str, float], *links: LinkStatus, cores: int = 4) -> EdgeStatus:
    """`scans`: robot → ms of a scan."""
    instances = tuple(
        InstanceStatus(robot=r, state="running", processed=9, pending=0, worker=0, scan_ms=ms, gaps=0, skipped=0)
        for r, ms in scans.items()
    )
    return EdgeStatus(
        edge=edge, cores=cores, cpu_s=1, rss_mb=1, instances=instances, fusing=(), stages={}, counters={}, links=links
    )


def notice(robot: str, edge: str, seq: int = 99, delay: float = 0.0) -> MapNotice:
    cover = Cover(stream=STREAM, seq=seq, epoch=(1, 1))
    return MapNotice(
        robot=robot,
        edge=edge,
        epoch=(1, 1),
        version=1,
        resolution=0.05,
        cover=cover,
        final=False,
        slam_s=1.0,
        transfer_s=delay,
    )


def status(robot: str, sent: int, ended: bool = False) -> RobotStatus:
    return RobotStatus(
        robot=robot,
        stream=STREAM,
        sent=sent,
        processed=sent,
        spooled=sent,
        spool_bytes=800 * sent,
        dropped=0,
        backfilled=0,
        ended=ended,
    )


def test_an_edge_is_as_fast_as_its_scans_are_against_the_profile() -> None:
    inputs = Inputs(fleet("e1", "e2", "e3"), Profile(slam_s={"lds01": 0.002}))
    for _ in range(3):
        inputs.hear(edge_status("e1", {"r1": 2.0, "r2": 2.0}), 1.0)
        inputs.hear(edge_status("e2", {"r3": 8.0}), 1.0)
    assert inputs.speed("e3") == pytest.approx(0.625), "not measured: as good as the measured ones, not better"
    assert inputs.speed("e1") == pytest.approx(1.0 / ALIKE)
    assert inputs.speed("e2") == pytest.approx(0.25 * ALIKE)
    assert inputs.scan_s("r3", "e2") / inputs.speed("e2") == pytest.approx(0.008, rel=0.25), (
        "where it runs: about as measured"
    )


def test_more_workers_than_cores_do_not_make_an_edge_look_slow() -> None:
    inputs = Inputs(fleet("e1").model_copy(update={"edge": EdgeConfig(workers=4)}), Profile(slam_s={"": 0.002}))
    inputs.hear(edge_status("e1", dict.fromkeys(("r1", "r2", "r3", "r4"), 4.0), cores=2), 1.0)
    assert inputs.speed("e1") == pytest.approx(1.0)


def test_robots_that_wait_for_a_worker_do_not_make_their_edge_look_fast() -> None:
    inputs = Inputs(fleet("e1", "e2"), Profile(slam_s={"": 0.002}))
    inputs.hear(edge_status("e1", dict.fromkeys(("r1", "r2", "r3", "r4"), 2.0), cores=2), 1.0)
    assert inputs.speed("e1") == pytest.approx(1.0)


def test_a_robot_with_a_heavier_sensor_does_not_make_its_edge_look_slow() -> None:
    inputs = Inputs(fleet("e1", "e2"), Profile(slam_s={"lds01": 0.002, "sick": 0.01}))
    for robot, sensor in (("r1", "lds01"), ("r2", "sick")):
        inputs.hear(RobotProfile(robot=robot, stream=STREAM, sensor=sensor), 0.0)
    inputs.hear(edge_status("e1", {"r1": 2.0}), 1.0)
    inputs.hear(edge_status("e2", {"r2": 10.0}), 1.0)
    assert inputs.speed("e1") == inputs.speed("e2") == pytest.approx(1.0)


def test_one_slow_report_is_no_slow_edge() -> None:
    inputs = Inputs(fleet("e1"), Profile(slam_s={"": 0.002}))
    for ms in (2.0, 2.0, 90.0, 2.0):
        inputs.hear(edge_status("e1", {"r1": ms}), 1.0)
    assert inputs.speed("e1") == pytest.approx(1.0)


def test_links_are_those_measured_and_unmeasured_ones_are_no_better() -> None:
    inputs = Inputs(fleet("e1", "e2"), Profile())
    link = LinkStatus(peer="robot/r1", bytes_per_s=1e5, delay_s=0.0, pages=9)
    few = LinkStatus(peer="robot/r2", bytes_per_s=1.0, delay_s=0.0, pages=1)
    inputs.hear(edge_status("e1", {"r1": 2.0}, link, few), 1.0)
    inputs.hear(notice("r1", "e1", delay=0.5), 1.0)
    routes = {robot: _route("e1") for robot in ("r1", "r2")}
    rows = inputs.robot_rows(("r1", "r2"), ("e1", "e2"), routes, {robot: ["e1", "e2"] for robot in routes})
    size = rows[0]["frame_bytes"]
    assert rows[0]["bandwidth"] == pytest.approx([size / (0.5 + size / 1e5)] * 2)
    assert rows[1]["bandwidth"] == pytest.approx([12.5e6] * 2)


def test_uplinks_are_measured_by_the_cloud() -> None:
    inputs = Inputs(fleet("e1", "e2"), Profile())
    link = LinkStatus(peer="edge/e1", bytes_per_s=1e6, delay_s=0.1, pages=9)
    inputs.hear(
        CloudStatus(
            version=1,
            world_epoch=1,
            robots=(),
            components=1,
            cpu_s=1,
            rss_mb=1,
            stages={},
            counters={},
            links=(link,),
        ),
        1.0,
    )
    assert [row["bandwidth"] for row in inputs.edge_rows(("e1", "e2"))] == pytest.approx([1e6, 1e6])
    assert inputs.figures(["e1"])["uplink e1 bytes/s"] == pytest.approx(1e6)


def test_a_round_holds_the_frames_that_the_robot_makes_between_two_fusions() -> None:
    live = fleet("e1").model_copy(update={"robot": RobotConfig(realtime=True)})
    inputs = Inputs(live, Profile(slam_s={"": 0.002}))
    for second in range(21):
        inputs.hear(status("r1", 5 * second), float(second))
    (row,) = inputs.robot_rows(("r1",), ("e1",), {"r1": _route("e1")}, {"r1": ["e1"]})
    assert row["frame_bytes"] == pytest.approx(10 * 800)
    assert row["slam_s"] == pytest.approx(10 * 0.002)
    assert row["move_s"] == pytest.approx(100 * 0.002)
    assert Inputs(fleet("e1"), Profile()).frame_hz("r1") == FRAME_HZ
    inputs.hear(status("r1", 101, ended=True), 21.0)
    (row,) = inputs.robot_rows(("r1",), ("e1",), {"r1": _route("e1")}, {"r1": ["e1"]})
    assert row["move_s"] == NEVER_S, "a robot that sends no more"


def test_a_robot_started_again_makes_frames_of_the_size_of_those_in_its_spool() -> None:
    inputs = Inputs(fleet("e1"), Profile())
    inputs.hear(status("r1", 1000).model_copy(update={"bytes_sent": 800}), 0.0)
    inputs.hear(status("r1", 1001).model_copy(update={"spooled": 0, "spool_bytes": 0}), 1.0)
    (row,) = inputs.robot_rows(("r1",), ("e1",), {"r1": _route("e1")}, {"r1": ["e1"]})
    assert row["frame_bytes"] == pytest.approx(20 * 800)


@pytest.mark.parametrize(
    "wrong",
    [
        {"sent": 0, "bytes_sent": 5},
        {"sent": -1, "spooled": -1, "spool_bytes": 800},
        {"spooled": 1, "spool_bytes": 2**60},
        {"pack_s": -1e300},
        {"pack_s": 1e300},
    ],
)
def test_a_robot_that_tells_what_cannot_be_is_planned_like_any_other(wrong: dict[str, float]) -> None:
    inputs = Inputs(fleet("e1"), Profile())
    inputs.hear(status("r1", 100).model_copy(update=wrong), 0.0)
    (row,) = inputs.robot_rows(("r1",), ("e1",), {"r1": _route("e1")}, {"r1": ["e1"]})
    assert 0 < row["frame_bytes"] < 20 * 2**20
    assert 0 <= row["pack_s"] <= 1
    assert row["move_s"] >= 0


def test_where_edges_share_checkpoints_a_robot_is_moved_for_the_frames_since_the_last_one(tmp_path: Path) -> None:
    shared = EdgeConfig(checkpoints=tmp_path, checkpoint_frames=50)
    inputs = Inputs(fleet("e1").model_copy(update={"edge": shared}), Profile(slam_s={"": 0.002}))
    prices = []
    for sent in (20, 5000):
        inputs.hear(status("r1", sent), 1.0)
        (row,) = inputs.robot_rows(("r1",), ("e1",), {"r1": _route("e1")}, {"r1": ["e1"]})
        prices.append(row["move_s"])
    assert prices == pytest.approx([20 * 0.002, 50 * 0.002])


def test_what_if_an_edge_were_slower_is_a_factor_on_its_speed() -> None:
    supposed = WhatIf.parse("e1=0.5,e2=down")
    assert supposed == WhatIf(frozenset({"e2"}), {"e1": 0.5})
    assert Inputs(fleet("e1"), Profile()).edge_rows(("e1",), supposed.speed)[0]["speed"] == 0.5
    for wrong in ("e1", "e1=0", "e1=slow"):
        with pytest.raises(UsageError, match="e1"):
            WhatIf.parse(wrong)
    with pytest.raises(UsageError, match="e2"):
        supposed.check(["e1"])
    with pytest.raises(UsageError, match="leave one up"):
        WhatIf.parse("e1=down").check(["e1"])


def test_fusion_times_are_learnt_from_what_edges_report() -> None:
    truth, times = FusionModel(0.1, 0.05, 1e-3), FusionTimes(FusionModel())
    rng = np.random.default_rng(0)
    for _ in range(150):
        maps, area = int(rng.integers(1, 9)), float(rng.uniform(20, 200))
        slow = 20.0 if rng.random() < 0.1 else rng.uniform(0.9, 1.1)
        times.took(maps, area, float(truth.seconds(maps, area)) * slow)
    model = times.model
    for maps, area in ((2, 50.0), (6, 100.0), (12, 300.0)):
        assert float(model.seconds(maps, area)) == pytest.approx(float(truth.seconds(maps, area)), rel=0.15)


def test_fusions_of_one_size_scale_the_profile_and_do_not_bend_it() -> None:
    prior = FusionModel()
    times = FusionTimes(prior)
    for _ in range(100):
        times.took(3, 100.0, 4 * float(prior.seconds(3, 100.0)))
    assert float(times.model.seconds(3, 100.0)) == pytest.approx(4 * float(prior.seconds(3, 100.0)), rel=0.1)
    assert float(times.model.seconds(12, 100.0)) > float(prior.seconds(12, 100.0))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 20), st.floats(0, 1e4), st.floats(0, 1e3)), max_size=30))
def test_no_report_makes_fusion_take_less_than_nothing(seen: list[tuple[int, float, float]]) -> None:
    times = FusionTimes(FusionModel())
    for maps, area, seconds in seen:
        times.took(maps, area, seconds)
    model = times.model
    assert min(model.map_s, model.pair_s, model.m2_s) >= 0


def test_reported_fusions_reach_the_planner_at_speed_one() -> None:
    inputs = Inputs(fleet("e1"), Profile(slam_s={"": 0.002}))
    inputs.hear(edge_status("e1", {"r1": 4.0}), 0.0)
    cover = Cover(stream=STREAM, seq=1, epoch=(1, 1))
    for version in range(50):
        inputs.hear(
            EdgeMapNotice(
                edge="e1",
                version=version,
                world_epoch=0,
                resolution=0.05,
                components=(),
                covers={"r1": cover, "r2": cover},
                final=False,
                fuse_s=0.4,
                area_m2=100.0,
            ),
            1.0,
        )
    assert float(FusionModel(*inputs.fusion()).seconds(2, 100.0)) == pytest.approx(0.2, rel=0.1)
    assert inputs.figures(["e1"])["fusions seen"] == 50


def test_a_profile_is_read_and_a_wrong_one_is_refused_by_name(tmp_path) -> None:
    path = tmp_path / "profile.toml"
    path.write_text("pair_s = 0.5\n[slam_s]\nlds01 = 0.002\nsick = 0.006\n")
    profile = load_profile(path)
    assert profile.scan_s("lds01") == 0.002
    assert profile.scan_s("other") == 0.004
    assert profile.fusion.pair_s == 0.5
    assert load_profile(None).scan_s("lds01") is None
    path.write_text("pair_s = -1\n")
    with pytest.raises(ConfigError, match=r"scheduler.profile: .*pair_s"):
        load_profile(path)
    with pytest.raises(ConfigError, match="recslam profile"):
        load_profile(tmp_path / "absent.toml")


def _route(edge: str):
    from common.wire import Route

    return Route(slam_edge=edge, fuse_edge=edge, epoch=(1, 1))
