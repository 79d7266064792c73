"""The predicted completion time is that of Eqs. 1-3."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scheduling_problems import problem

from services.scheduler.costs import FusionModel, predict


def by_hand(task, slam, fuse) -> float:
    """t_c with one loop per equation."""
    model, share, arrivals = task.fusion, task.map_bytes_per_m2, []

    def fusing(k, area):
        return model.map_s * k + model.pair_s * k * (k - 1) / 2 + model.m2_s * area

    for e in range(len(task.edges)):
        members = [r for r in range(len(task.robots)) if fuse[r] == e]
        if not members:
            continue
        ready = []
        for r in members:
            s, own = slam[r], len(task.footprints[r])
            crowd = max(1.0, sum(x == s for x in slam) / task.cores[s])
            t = (
                task.pack_s[r]
                + task.frame_bytes[r] / task.robot_bandwidth[r, s]
                + task.slam_s[r] * crowd / task.speed[s]
            )
            carry = 0.0 if s == e else own * share / min(task.edge_bandwidth[s], task.edge_bandwidth[e])
            if task.current_slam[r] not in (-1, s):
                t += task.move_cost[r] / task.horizon
            if task.current_fuse[r] not in (-1, e):
                t += carry / task.horizon
            ready.append(t + carry)
        area = len(set().union(*(set(task.footprints[r].tolist()) for r in members)))
        arrivals.append(max(ready) + fusing(len(members), area) / task.speed[e] + area * share / task.edge_bandwidth[e])
    everything = len(set().union(*(set(f.tolist()) for f in task.footprints)))
    return max(arrivals) + fusing(len(arrivals), everything) / task.cloud_speed


@pytest.mark.parametrize("seed", range(6))
def test_the_prediction_follows_the_equations(seed: int) -> None:
    task = problem(11, 4, seed=seed, placed=seed % 2 == 0)
    rng = np.random.default_rng(seed)
    slam, fuse = rng.integers(0, 4, 11), rng.integers(0, 4, 11)
    assert predict(task, slam, fuse).total == pytest.approx(by_hand(task, slam, fuse), rel=1e-12)
    assert predict(task, slam, slam).total == pytest.approx(by_hand(task, slam, slam), rel=1e-12)


def test_the_critical_path_sums_up_to_the_total() -> None:
    task = problem(9, 3, placed=True)
    prediction = predict(task, np.arange(9) % 3, (np.arange(9) + 1) % 3)
    assert sum(stage.seconds for stage in prediction.critical) == pytest.approx(prediction.total)
    assert [stage.what for stage in prediction.critical] == [
        "pack", "transfer", "slam", "move", "carry", "fuse", "upload", "merge",
    ]  # fmt: skip


def test_an_edge_that_fuses_nothing_takes_no_time() -> None:
    prediction = predict(problem(4, 3), np.zeros(4, int), np.zeros(4, int))
    assert prediction.edges[1:].tolist() == [0, 0]


def test_staying_costs_nothing_and_moving_is_spread_over_the_horizon() -> None:
    task = problem(1, 2, placed=True)
    task = dataclasses.replace(
        task, speed=np.ones(2), edge_bandwidth=np.full(2, 1e6), robot_bandwidth=np.full((1, 2), 1e6)
    )
    stay = predict(task, task.current_slam, task.current_fuse)
    move = predict(task, 1 - task.current_slam, 1 - task.current_fuse)
    assert move.total - stay.total == pytest.approx(0.6 / task.horizon)


def test_fusion_is_quadratic_in_the_maps_and_free_without_any() -> None:
    model = FusionModel(map_s=1.0, pair_s=1.0, m2_s=0.5)
    assert model.seconds(np.array([0, 1, 2, 3]), 2.0).tolist() == [0.0, 2.0, 4.0, 7.0]


def test_a_map_of_which_nothing_is_known_is_carried_like_an_average_one() -> None:
    task = problem(3, 2)
    unknown = dataclasses.replace(task, footprints=(np.empty(0, dtype=np.int64), np.arange(10), np.arange(30)))
    assert unknown.map_m2.tolist() == [20.0, 10.0, 30.0]
    nothing = dataclasses.replace(task, footprints=(np.empty(0, dtype=np.int64),) * 3)
    assert nothing.map_m2.tolist() == [0.0, 0.0, 0.0]
