"""The relations metric: ours is the published one, and an independent scorer agrees to the last digits."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from common.errors import BadFile, UsageError
from common.evaluation.relations import read_odometry, read_relations, score_relations
from common.formats.carmen import CarmenLog
from common.formats.segments import cut
from common.formats.tum import read_trajectory, write_trajectory
from common.geometry import between, compose

DATA, SCORER = os.environ.get("RECSLAM_DATA"), os.environ.get("RECSLAM_SCORER")
needs_scorer = pytest.mark.skipif(
    not (DATA and SCORER), reason="RECSLAM_DATA and RECSLAM_SCORER do not name real logs and an independent scorer"
)


def circle(t: np.ndarray) -> np.ndarray:
    return np.column_stack([t, np.cos(t / 10), np.sin(t / 10), t / 10 + np.pi / 2])


def relations_of(track: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    return np.array([[track[i, 0], track[j, 0], *between(track[i, 1:], track[j, 1:])] for i, j in pairs])


TRUTH = circle(np.arange(0.0, 40.0, 0.5))


def test_a_true_trajectory_in_any_frame_has_no_error():
    relations = relations_of(TRUTH, [(0, 10), (50, 3), (20, 79)])
    elsewhere = np.column_stack([TRUTH[:, 0], compose((5, -3, 2), TRUTH[:, 1:])])
    stats = score_relations(relations, TRUTH, [elsewhere]).stats(exact=True)
    assert stats.n == 3
    assert stats.translation_max == pytest.approx(0, abs=1e-12)
    assert stats.rotation == pytest.approx(0, abs=1e-9)


def test_between_sparse_estimates_poses_are_carried_by_odometry():
    relations = relations_of(TRUTH, [(7, 33), (8, 16)])
    drifting = np.column_stack([TRUTH[:, 0], compose((1, 1, 1), TRUTH[:, 1:])])
    score = score_relations(relations, drifting, [TRUTH[::16]])
    assert score.exact.tolist() == [False, False]
    assert score.translation.max() == pytest.approx(0, abs=1e-9)
    assert score_relations(relations, drifting, [TRUTH[::8]]).exact.tolist() == [False, True]


def test_relations_across_robots_judge_how_the_robots_lie_to_each_other():
    relations = relations_of(TRUTH, [(0, 10), (5, 70), (60, 70), (75, 1)])
    second = np.column_stack([TRUTH[40:, 0], compose((0.3, 0, 0), TRUTH[40:, 1:])])
    score = score_relations(relations, TRUTH, [TRUTH[:40], second])
    assert score.across.tolist() == [False, True, False, True]
    assert score.stats(across=False).translation == pytest.approx(0, abs=0.05)
    across = score.stats(across=True)
    assert (across.n, across.translation) == (2, pytest.approx(0.3, abs=1e-9))
    assert score.stats().n == 4


def test_relations_outside_every_track_are_counted_not_scored():
    relations = relations_of(circle(np.array([0.0, 10, 50, 100])), [(0, 1), (0, 2), (1, 3)])
    score = score_relations(relations, TRUTH, [TRUTH])
    assert (score.unscored, len(score.translation)) == (2, 1)
    assert np.isnan(score.stats(across=True).translation)


def test_what_cannot_be_scored_is_refused(tmp_path):
    with pytest.raises(UsageError, match="track 1 has 1 rows"):
        score_relations(relations_of(TRUTH, [(0, 1)]), TRUTH, [TRUTH, TRUTH[:1]])
    with pytest.raises(UsageError, match="no track"):
        score_relations(relations_of(TRUTH, [(0, 1)]), TRUTH, [])
    (tmp_path / "r").write_text("# none\n1 2 3\n")
    with pytest.raises(BadFile, match="holds no rows"):
        read_relations(tmp_path / "r")


@needs_scorer
@pytest.mark.parametrize("robots", [1, 3])
def test_an_independent_scorer_agrees(tmp_path, robots):
    data = Path(DATA)
    log, truth = data / "logs" / "intel_dense.raw.log.gz", data / "relations" / "intel.relations.gz"
    reference = read_trajectory(data / "reference" / "intel.ref.txt.gz")
    sweeps = list(CarmenLog(log))
    paths, tracks = [], []
    for robot in range(robots):
        stamps = [sweep.stamp for sweep in cut(sweeps, robot, robots)]
        rows = reference[(reference[:, 0] >= stamps[0]) & (reference[:, 0] <= stamps[-1])]
        paths.append(tmp_path / f"{robot}.tum")
        write_trajectory(paths[-1], rows)
        tracks.append(read_trajectory(paths[-1]))
    ours = score_relations(read_relations(truth), read_odometry(log), tracks)

    spec = importlib.util.spec_from_file_location("scorer", SCORER)
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    rows, unscored = scorer.score(str(truth), str(log), [str(path) for path in paths])
    theirs = np.array(rows, float)
    assert ours.unscored == unscored
    np.testing.assert_allclose(ours.translation, theirs[:, 0], atol=1e-9)
    np.testing.assert_allclose(ours.rotation, theirs[:, 1], atol=1e-9)
    np.testing.assert_array_equal(ours.exact, theirs[:, 2] == 1)
    np.testing.assert_array_equal(ours.across, theirs[:, 3] == 1)

    run = subprocess.run([sys.executable, SCORER, truth, log, *paths], capture_output=True, text=True)
    for name, stats in (("all", ours.stats()), ("exact", ours.stats(exact=True))):
        line = re.search(rf"^{name} +(\d+) relations  trans ([\d.]+) \+- ([\d.]+) m", run.stdout, re.M)
        assert int(line[1]) == stats.n
        assert float(line[2]) == pytest.approx(stats.translation, abs=6e-5)
        assert float(line[3]) == pytest.approx(stats.translation_sd, abs=6e-5)
