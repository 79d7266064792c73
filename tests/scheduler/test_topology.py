"""Topologies seen from the scheduler."""

from __future__ import annotations

import pytest

from services.scheduler.topology import Topology


@pytest.mark.parametrize("name", ["recslam", "edge-only"])
def test_regrouping_topologies_leave_the_choice_to_the_load(name: str) -> None:
    assert Topology(name).regroups
    assert Topology(name).edge_for("r1", ["edge-r1", "e2"]) is None


@pytest.mark.parametrize("name", ["cloud", "local"])
def test_a_robot_goes_to_the_edge_beside_it(name: str) -> None:
    assert not Topology(name).regroups
    assert Topology(name).edge_for("r1", ["edge-r1", "edge-r2"]) == "edge-r1"


def test_everybody_goes_to_the_single_edge() -> None:
    assert not Topology("single-edge").regroups
    assert {Topology("single-edge").edge_for(robot, ["e2", "e1"]) for robot in ("r1", "r2")} == {"e1"}
