"""Cutting one run into several robots: nothing lost, nothing told."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from common.errors import UsageError
from common.formats.segments import cut, hide_start
from common.geometry import between
from common.sweep import LaserGeometry, Sweep

GEOMETRY = LaserGeometry(-1.0, 0.1, 0.0, 10.0)


def run(count: int = 31) -> list[Sweep]:
    rng = np.random.default_rng(0)
    out = []
    for i in range(count):
        stamps = i - np.array([0.75, 0.5, 0.0])
        out.append(
            Sweep(float(i), GEOMETRY, np.ones(3, np.float32), np.column_stack([stamps, rng.normal(size=(3, 3))]))
        )
    return out


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
def test_segments_are_equally_long_and_hold_every_sweep_once(parts):
    sweeps = run()
    segments = [cut(iter(sweeps), part, parts) for part in range(parts)]
    assert [s.stamp for segment in segments for s in segment] == [s.stamp for s in sweeps]
    assert all(30 * part / parts <= segment[0].stamp for part, segment in enumerate(segments))
    assert all(segment[-1].stamp <= 30 * (part + 1) / parts for part, segment in enumerate(segments))
    for before, after in pairwise(segments):
        assert after[0].odometry[0, 0] >= before[-1].stamp


def test_a_part_that_is_not_there_is_refused():
    with pytest.raises(UsageError, match="0 to 2"):
        cut(run(), 3, 3)
    assert cut([], 0, 2) == []


def test_a_hidden_start_moves_all_odometry_rigidly_and_only_that():
    sweeps = run()
    hidden = hide_start(sweeps, seed=4)
    before, after = (np.concatenate([s.odometry for s in run]) for run in (sweeps, hidden))
    np.testing.assert_array_equal(before[:, 0], after[:, 0])
    np.testing.assert_allclose(between(before[0, 1:], before[:, 1:]), between(after[0, 1:], after[:, 1:]), atol=1e-9)
    assert all(a.ranges is b.ranges and a.stamp == b.stamp for a, b in zip(sweeps, hidden, strict=True))


def test_the_hidden_start_depends_on_the_seed_alone():
    sweeps = run()
    elsewhere = hide_start(sweeps, seed=9)
    first = hide_start(sweeps, seed=4)[0].odometry
    np.testing.assert_array_equal(first, hide_start(sweeps, seed=4)[0].odometry)
    np.testing.assert_allclose(first, hide_start(elsewhere, seed=4)[0].odometry, atol=1e-9)
    assert not np.allclose(first, elsewhere[0].odometry, atol=0.1)


def test_without_odometry_there_is_nothing_to_hide():
    sweeps = [Sweep(1.0, GEOMETRY, np.ones(3, np.float32))]
    assert hide_start(sweeps, 1) == sweeps
    assert hide_start([], 1) == []
