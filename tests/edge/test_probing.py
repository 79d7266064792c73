"""Idle links are measured now and then, others never."""

from __future__ import annotations

import pytest

from common.link import LinkMeter
from services.edge_worker.probing import SIZES, Idle


def probed(idle: Idle, robots: list[str], taken: dict[str, int], seconds: range) -> list[tuple[int, str]]:
    return [(now, robot) for now in seconds if (robot := idle.due(robots, taken, float(now))) is not None]


def test_each_idle_link_is_probed_once_in_the_interval_whether_it_answers_or_not() -> None:
    found = probed(Idle(30.0), ["r1", "r2"], {}, range(100))
    assert [now for now, robot in found if robot == "r1"] == [30, 60, 90]
    assert [now for now, robot in found if robot == "r2"] == [31, 61, 91]


def test_a_link_that_traffic_measures_is_never_probed() -> None:
    idle, taken = Idle(30.0), {"r1": 0}
    for now in range(0, 200, 20):
        taken["r1"] += 1
        assert probed(idle, ["r1"], taken, range(now, now + 20)) == []
    assert probed(idle, ["r1"], taken, range(200, 260)) == [(210, "r1"), (240, "r1")]


def test_three_probes_tell_the_speed_of_a_link() -> None:
    meter = LinkMeter()
    for _ in range(3):
        for size in SIZES:
            meter.took("robot/r1", size, 0.01 + size / 1e6)
    (link,) = meter.statuses()
    assert link.bytes_per_s == pytest.approx(1e6)
    assert link.delay_s == pytest.approx(0.01)
    assert meter.taken("robot/") == {"r1": 6}
    assert meter.taken("edge/") == {}
