"""Folders of runs, and how a running cluster is found through them."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from command_line import call

from common.errors import BadFile, UsageError
from services.command import fleets
from services.command.finding import find
from services.command.run_folder import LATEST, Cluster, RunFolder, read_cluster

HERE = Cluster("tcp/127.0.0.1:1234", "recslam/v1", "pair", os.getpid(), time.time())


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RECSLAM_ENDPOINT", raising=False)


def test_runs_that_start_in_one_second_do_not_share_a_folder() -> None:
    folders = [RunFolder.make(None).path for _ in range(5)]
    assert len(set(folders)) == 5
    assert LATEST.resolve() == folders[-1]


def test_a_folder_of_ones_own_is_the_latest_run_too(tmp_path: Path) -> None:
    folder = RunFolder.make(tmp_path / "elsewhere" / "run")
    folder.announce(HERE)
    assert (LATEST.resolve(), read_cluster(LATEST / "cluster.json")) == (folder.path, HERE)


def test_a_folder_in_which_a_cluster_runs_is_refused(tmp_path: Path) -> None:
    RunFolder.make(tmp_path / "run").announce(HERE)
    with pytest.raises(UsageError, match="a cluster is running there"):
        RunFolder.make(tmp_path / "run")


def test_a_broken_off_run_goes_on_with_its_own_fleet_and_with_no_other(tmp_path: Path) -> None:
    fleet = fleets.load_fleet("two_rooms")
    folder = RunFolder.make(tmp_path / "run")
    fleets.write(fleet, folder.config)
    assert not folder.spooled
    folder.spool.mkdir()
    (folder.spool / "r1.spool").touch()
    assert folder.spooled
    assert fleets.same_frames(fleets.revised(fleet, slam={"kernel": "gmapping"}), folder.config)
    assert not fleets.same_frames(fleets.revised(fleet, seed=9), folder.config)
    assert not fleets.same_frames(fleets.load_fleet("apartment"), folder.config)
    done = call("up", "apartment", "--out", folder.path, cwd=tmp_path)
    assert done.returncode == 2
    assert "has frames of another fleet" in done.stderr
    assert fleets.same_frames(fleet, folder.config), "what was there is left alone"


def test_a_cluster_is_found_by_option_then_by_the_latest_run_then_by_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find(None).endpoint == "tcp/127.0.0.1:7447"
    monkeypatch.setenv("RECSLAM_ENDPOINT", "tcp/10.0.0.1:7447")
    assert find(None).endpoint == "tcp/10.0.0.1:7447"
    folder = RunFolder.make(tmp_path / "run")
    folder.announce(HERE)
    assert find(None).endpoint == HERE.endpoint
    assert find("tcp/10.0.0.2:7447").endpoint == "tcp/10.0.0.2:7447"
    folder.withdraw()
    assert find(None).endpoint == "tcp/10.0.0.1:7447"


def test_a_cluster_file_that_is_none_is_refused_by_name(tmp_path: Path) -> None:
    RunFolder.make(tmp_path / "run").cluster.write_text("{}")
    with pytest.raises(BadFile, match=r"cluster\.json"):
        find(None)
