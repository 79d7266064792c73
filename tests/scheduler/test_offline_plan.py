"""Planning from a matrix file."""

from __future__ import annotations

import numpy as np
import pytest
from scheduling_problems import graph

from common.errors import BadFile, UsageError
from services.scheduler.graph import cut
from services.scheduler.offline import plan_matrix, read_matrix, shared_footprints
from services.scheduler.policies import POLICIES


@pytest.mark.parametrize("policy", POLICIES)
def test_every_policy_groups_all_robots_of_a_file(tmp_path, policy: str) -> None:
    weights = graph("sparse", 14, seed=1)
    path = tmp_path / "matrix.npz"
    np.savez(path, weights=weights)
    result = plan_matrix(path, 3, policy, 0.05)
    labels = np.empty(14, dtype=int)
    for edge, group in enumerate(result.groups):
        labels[list(group)] = edge
    assert sorted(robot for group in result.groups for robot in group) == list(range(14))
    assert result.cut == cut(weights, labels)
    assert result.to_dict()["total_weight"] == weights.sum() / 2
    assert result.to_dict()["sizes"] == [len(group) for group in result.groups]


def test_csv_and_npz_give_the_same_plan(tmp_path) -> None:
    weights = graph("dense", 9)
    np.savetxt(tmp_path / "m.csv", weights, delimiter=",", fmt="%.18g")
    np.savez(tmp_path / "m.npz", weights=weights)
    assert np.array_equal(read_matrix(tmp_path / "m.csv"), read_matrix(tmp_path / "m.npz"))
    assert plan_matrix(tmp_path / "m.csv", 2, "cut", 1).groups == plan_matrix(tmp_path / "m.npz", 2, "cut", 1).groups


def test_a_file_that_holds_no_matrix_is_refused_by_name(tmp_path) -> None:
    (tmp_path / "text.csv").write_text("a,b\n1,2\n")
    (tmp_path / "empty.csv").touch()
    (tmp_path / "broken.npz").write_bytes(b"PK")
    np.savez(tmp_path / "other.npz", matrix=np.zeros((2, 2)))
    np.savez(tmp_path / "skew.npz", weights=np.array([[0, 0.1], [0.2, 0]]))
    np.savez(tmp_path / "good.npz", weights=np.zeros((2, 2)))
    for name in ("text.csv", "empty.csv", "broken.npz", "other.npz", "skew.npz", "absent.npz", "matrix.txt"):
        with pytest.raises(BadFile, match=name):
            read_matrix(tmp_path / name)
    with pytest.raises(UsageError, match="edges"):
        plan_matrix(tmp_path / "good.npz", 0, "cut", 1)


def test_made_up_footprints_share_what_the_matrix_says() -> None:
    weights = np.array([[0, 0.25, 0], [0.25, 0, 0.125], [0, 0.125, 0]])
    cells = [set(each.tolist()) for each in shared_footprints(weights)]
    assert [len(each) for each in cells] == [100, 100, 100]
    assert len(cells[0] & cells[1]) == 50
    assert len(cells[1] & cells[2]) == 25
    assert not cells[0] & cells[2]
