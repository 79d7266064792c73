"""The main job, end to end: the demo's map is as good as promised, and robots cut out of a real log make one map."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_line import call

from common.evaluation.relations import read_odometry, read_relations, score_relations
from common.formats.tum import read_trajectory

DATA = os.environ.get("RECSLAM_DATA")

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(300)]


def test_the_demo_maps_the_apartment_in_one_piece_and_right(tmp_path: Path) -> None:
    done = call("demo", "--out", tmp_path / "demo", cwd=tmp_path, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads((tmp_path / "demo" / "report.json").read_text())
    assert len(told["components"]) == 1
    assert told["final"]
    assert told["accuracy"]["iou"] >= 0.85
    assert told["accuracy"]["missing"] == []


@pytest.mark.skipif(not DATA, reason="RECSLAM_DATA does not name a folder of real logs")
def test_three_robots_that_know_nothing_of_each_other_map_a_real_building_together(tmp_path: Path) -> None:
    assert DATA is not None
    log, out = Path(DATA) / "logs" / "intel_dense.raw.log.gz", tmp_path / "intel"
    done = call("replay", log, "--robots", 3, "--edges", 2, "--out", out, cwd=tmp_path, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads((out / "report.json").read_text())
    assert len(told["components"]) == 1
    tracks = [read_trajectory(path) for path in sorted((out / "robots").glob("*.tum"))]
    score = score_relations(read_relations(Path(DATA) / "relations" / "intel.relations.gz"), read_odometry(log), tracks)
    assert score.unscored == 0
    assert score.stats(across=False).translation <= 0.10
    assert score.stats(across=True).translation <= 0.08
