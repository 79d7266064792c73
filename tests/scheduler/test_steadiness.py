"""The scheduler, its measurements and its planner together, on a cluster that exists in messages only."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.synthetic_cluster import SyntheticCluster


@pytest.mark.parametrize("policy", ["paper", "recslam"])
def test_ten_minutes_of_noisy_measurements_move_nobody(policy: str) -> None:
    cluster = SyntheticCluster(10, 3, policy=policy, noise=0.2, seed=1)
    cluster.start()
    cluster.run(30)
    settled, moved = len(cluster.tables), cluster.state.moved
    cluster.run(600)
    assert [step.reason for step in cluster.tables[settled:]] == []
    assert cluster.state.moved == moved
    assert len(cluster.plan_s) >= 200


def test_an_edge_that_turns_four_times_slower_is_relieved_within_three_intervals() -> None:
    cluster = SyntheticCluster(6, 3, noise=0.05, seed=2)
    cluster.start()
    cluster.run(60)
    before = cluster.state.load()["e1"]
    cluster.slowed["e1"] = 4.0
    cluster.run(10)
    assert before >= 1
    assert cluster.state.load()["e1"] < before


@settings(max_examples=25, deadline=None)
@given(data=st.data(), policy=st.sampled_from(("paper", "recslam", "cut", "greedy", "random")))
def test_no_plan_names_an_edge_that_a_robot_cannot_reach(data: st.DataObject, policy: str) -> None:
    edges = st.sets(st.sampled_from(("e0", "e1", "e2")), min_size=1).map(lambda names: tuple(sorted(names)))
    reach = {f"r{number:04d}": data.draw(edges) for number in range(7)}
    cluster = SyntheticCluster(7, 3, policy=policy, budget_s=0.005, noise=0.5, reach=reach)
    cluster.start()
    cluster.run(13)
    assert cluster.tables
    for step in cluster.tables:
        for robot, route in step.routes.routes.items():
            assert {route.slam_edge, route.fuse_edge} <= set(reach[robot])
