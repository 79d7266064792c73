"""TUM trajectories: planar poses come back, and files of others are read or refused by line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import BadFile
from common.formats.tum import read_trajectory, write_trajectory

rows = st.lists(
    st.tuples(st.floats(0, 2e9), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-np.pi, np.pi)), max_size=30
)


@given(rows)
def test_a_trajectory_comes_back_as_it_was_written(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    expected = np.array(rows, float).reshape(-1, 4)
    write_trajectory(path, expected)
    read = read_trajectory(path)
    np.testing.assert_allclose(read[:, :3], expected[:, :3], atol=1e-9, rtol=0)
    np.testing.assert_allclose(np.exp(1j * read[:, 3]), np.exp(1j * expected[:, 3]), atol=1e-9)


def test_stamps_keep_what_a_double_holds(tmp_path):
    write_trajectory(tmp_path / "a", [[976052890.244111, 0, 0, 0]])
    assert read_trajectory(tmp_path / "a")[0, 0] == 976052890.244111


def test_the_yaw_of_a_pose_in_space_is_taken(tmp_path):
    (tmp_path / "a").write_text("# comment\n1.5 1 2 9 0 0 0.7071068 0.7071068\n2.5 1 2 -1.5\n")
    np.testing.assert_allclose(read_trajectory(tmp_path / "a"), [[1.5, 1, 2, np.pi / 2], [2.5, 1, 2, -1.5]], atol=1e-7)


@pytest.mark.parametrize("line", ["1 2 3", "1 2 3 x", "1 2 3 nan"])
def test_a_broken_line_is_named(tmp_path, line):
    (tmp_path / "a").write_text(f"# head\n1 0 0 0\n{line}\n")
    with pytest.raises(BadFile, match="a:3:"):
        read_trajectory(tmp_path / "a")
    with pytest.raises(BadFile, match="NaN"):
        write_trajectory(tmp_path / "b", [[1, 2, float("nan"), 0]])
