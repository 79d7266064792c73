"""Promises of the process that hosts SLAM instances about the maps that it shows."""

from __future__ import annotations

import numpy as np
import pytest
from graph_cases import driven

from common.wire import TrajectoryPage, decode, encode
from services.edge_worker.slam import host as hosting
from services.edge_worker.slam.host import SlamHost

EVERYTHING = 1 << 30


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> SlamHost:
    """With a robot whose map has been shown and whose next one takes many rounds to draw."""
    host = SlamHost()
    host.open("r1", 1, "graph", {}, 0)
    for frame in driven()[:150]:
        host.process("r1", encode(frame))
    while host.idle():
        pass
    host.news("r1")
    monkeypatch.setattr(hosting, "ASKED_S", 0.0)
    monkeypatch.setattr(hosting, "IDLE_S", 0.0)
    poses = host._instances["r1"].kernel.graph.poses
    poses += np.linspace(0.0, 1.0, len(poses))[:, None] * [0.5, 0.0, 0.0]
    for frame in driven()[150:152]:
        host.process("r1", encode(frame))
    return host


def shown(host: SlamHost) -> tuple[object, ...]:
    """Version, last frame and corrections of the map, its tiles and its trajectory."""
    page = host.tiles("r1", "counts", 0, "", EVERYTHING)
    rows = decode(host.trajectory("r1", 0), sender="r1")
    assert isinstance(rows, TrajectoryPage)
    assert rows.version == page["version"]
    return page["version"], page["seq"], page["corrections"], tuple(page["tiles"]), rows.poses.tobytes()


def test_while_a_correction_is_drawn_the_map_before_is_shown_with_what_belongs_to_it(host: SlamHost) -> None:
    before = shown(host)
    assert before[1:3] == (149, 0)
    host.idle()
    assert shown(host) == before
    while host.idle():
        pass
    after = shown(host)
    assert after[1:3] == (151, 1)
    assert all(new != old for new, old in zip(after, before, strict=True))


def test_a_worker_that_is_never_idle_shows_the_correction_all_the_same(
    host: SlamHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert host.news("r1")["seq"] == 149
    monkeypatch.setattr(hosting, "BEHIND_S", 0.0)
    assert host.news("r1")["seq"] == 151


def test_a_final_map_is_shown_at_once(host: SlamHost) -> None:
    host.finish("r1")
    news = host.news("r1")
    assert (news["seq"], news["final"], news["corrections"]) == (151, True, 1)


def test_an_idle_worker_has_nothing_to_do_once_all_is_drawn(host: SlamHost) -> None:
    while host.idle():
        pass
    assert not host.idle()


def test_an_instance_that_goes_on_from_a_snapshot_shows_its_whole_map_at_once(host: SlamHost) -> None:
    host.open("r2", 1, "graph", {}, 0, host.snapshot("r1"))
    while host.news("r1")["seq"] < 151:
        host.idle()
    assert host.news("r2")["seq"] == 151
    one, other = (host._instances[robot].shown.grid for robot in ("r1", "r2"))
    assert one.digest() == other.digest()
