"""Graph SLAM on real logs; RECSLAM_DATA names the folder that holds them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from graph_cases import STREAM, run

from common.evaluation.maps import wall_thickness
from common.evaluation.relations import read_odometry, read_relations, score_relations
from common.evaluation.trajectory import absolute_error
from common.formats.carmen import CarmenLog
from common.wire import Frame
from services.robot_agent.packing import pack

pytestmark = pytest.mark.skipif("RECSLAM_DATA" not in os.environ, reason="RECSLAM_DATA does not name the real logs")
DATA = Path(os.environ.get("RECSLAM_DATA", ""))


def frames(log: str) -> list[Frame]:
    return [pack(sweep, "robot", STREAM, seq) for seq, sweep in enumerate(CarmenLog(DATA / "logs" / log))]


def test_intel_is_closed_and_accurate() -> None:
    kernel = run(frames("intel.raw.log.gz"))
    kernel.finish()
    rows = kernel.trajectory()
    relations = read_relations(DATA / "relations/intel.relations.gz")
    odometry = read_odometry(DATA / "logs/intel_dense.raw.log.gz")
    score = score_relations(relations, odometry, [rows], exact_s=1e-4)
    assert score.unscored == 0
    assert score.stats(exact=True).translation < 0.02
    assert score.stats().translation < 0.06
    assert wall_thickness(kernel.map().occupancy()[0]) < 2.0


def test_aces_closes_its_loops() -> None:
    kernel = run(frames("aces.raw.log.gz"))
    kernel.finish()
    reference = np.loadtxt(DATA / "reference/aces.ref.txt.gz")
    assert absolute_error([kernel.trajectory()], [reference]).max < 0.7
