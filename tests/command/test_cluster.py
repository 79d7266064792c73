"""Whole clusters out of one command: real processes, a real router, a real map."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import all_gone, call, family, read_until, start, write_fleet

from common.formats.map_server import read_map
from common.formats.tum import read_trajectory

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(240)]

SLOW = "robot.realtime = true\n"
"""so that a run does not end while it is looked at"""


class Kept:
    """A cluster that stays up after its final map."""

    def __init__(self, recording: Path, folder: Path) -> None:
        self.folder = folder
        self.process = start("replay", recording, "--keep", cwd=folder)
        self.said = read_until(self.process, "the cluster stays up at ")
        self.endpoint = self.said.split("stays up at ")[1].split(";")[0]
        self.run = (folder / "runs" / "latest").resolve()

    def command(self, *words: object) -> str:
        done = call(*words, cwd=self.folder)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def kept(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kept]:
    cluster = Kept(recording, tmp_path_factory.mktemp("kept"))
    yield cluster
    with cluster.process as process:
        process.kill()


def report(run: Path) -> dict[str, object]:
    data: dict[str, object] = json.loads((run / "report.json").read_text())
    return data


def test_a_replay_leaves_map_trajectories_transforms_and_a_report(kept: Kept) -> None:
    saved = read_map(kept.run / "global_map.yaml")
    assert (saved.occupancy == 100).sum() > 200
    assert (kept.run / "global_map.png").stat().st_size > 1000
    told = json.loads((kept.run / "transforms.json").read_text())
    assert (told["final"], told["components"], set(told["robots"])) == (True, [["r1", "r2"]], {"r1", "r2"})
    for robot in ("r1", "r2"):
        track = read_trajectory(kept.run / "robots" / f"{robot}.tum")
        assert len(track) == 110
        assert np.allclose(np.diff(track[:, 0]), 1 / 5.5, atol=1e-5)
    found = report(kept.run)
    assert found["frames"] == {"r1": 110, "r2": 110}
    assert found["unplaced"] == []
    assert "Critical path: " in (kept.run / "report.md").read_text()


def test_a_replay_of_a_simulation_is_scored_against_its_truth(kept: Kept) -> None:
    accuracy = report(kept.run)["accuracy"]
    assert isinstance(accuracy, dict)
    assert accuracy["iou"] > 0.6
    assert accuracy["coverage"] > 0.95
    assert accuracy["ate_m"]["all"] < 0.05
    assert "IoU" in kept.said


def test_status_shows_who_is_there_and_what_the_plan_is(kept: Kept) -> None:
    text = kept.command("status")
    assert "r1" in text
    assert "edge-1" in text
    assert "final, 1 component(s): r1, r2" in text
    data = json.loads(kept.command("status", "--json"))
    assert set(data["robots"]) == {"r1", "r2"}
    assert data["map"]["final"] is True


def test_doctor_finds_a_sound_cluster_sound(kept: Kept) -> None:
    text = kept.command("doctor")
    assert "BAD" not in text
    assert "doctor" not in text, "its own round trip is nobody's"
    assert "cloud, edge/edge-1, edge/edge-2, robot/r1, robot/r2, scheduler" in text
    assert "cloud/map: GlobalMapNotice" in text
    assert "clocks: 6 compared" in text


def test_why_tells_and_shows_what_holds_two_robots_together(kept: Kept, tmp_path: Path) -> None:
    text = kept.command("why", "r2", "r1", "--picture", tmp_path / "pair")
    assert "r1 - r2: merged (final, decided by " in text
    assert "they lie in one component" in text
    assert "the decided placement" in text
    assert (tmp_path / "pair").read_bytes().startswith(b"\x89PNG")
    data = json.loads(kept.command("why", "r1", "r2", "--json"))
    assert (data["kind"], data["one_component"]) == ("merged", True)
    missing = call("why", "r1", "r9", cwd=kept.folder)
    assert (missing.returncode, "compared so far: r1, r2" in missing.stderr) == (2, True)
    same = call("why", "r1", "r1", cwd=kept.folder)
    assert (same.returncode, "name two robots" in same.stderr) == (2, True)


def test_the_map_can_be_saved_from_outside(kept: Kept, tmp_path: Path) -> None:
    (number,) = re.findall(r"^map (\d+), final", kept.command("status"), re.MULTILINE)
    saved = kept.command("map", "save", tmp_path, "--name", "flat")
    assert saved.startswith(f"map {number} (final, 1 component(s)) in ")
    again, first = read_map(tmp_path / "flat.yaml"), read_map(kept.run / "global_map.yaml")
    assert np.array_equal(again.occupancy, first.occupancy)
    assert again.origin == first.origin


def test_the_zenoh_cli_commands_of_the_readme_work(kept: Kept) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    printed = []
    for line in readme.splitlines():
        if line.startswith("zenoh "):
            words = shlex.split(line.replace("tcp/127.0.0.1:7447", kept.endpoint))
            words[0] = str(Path(sys.executable).with_name("zenoh"))
            done = subprocess.run(words, capture_output=True, text=True, timeout=60)
            assert done.returncode == 0, done.stderr
            printed.append(done.stdout)
    statuses, tokens = printed
    assert 'recslam/v1/robot/r2/status {"message": "RobotStatus"' in statuses
    assert "recslam/v1/edge/edge-1/alive" in tokens


def test_a_second_cluster_beside_it_makes_the_same_map_in_another_topology(
    kept: Kept, recording: Path, tmp_path: Path
) -> None:
    done = call("replay", recording, "--topology", "cloud", "--out", tmp_path / "out", cwd=tmp_path, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    theirs, ours = report(kept.run)["map"], report(tmp_path / "out")["map"]
    assert isinstance(theirs, dict)
    assert isinstance(ours, dict)
    assert theirs["digest"] == ours["digest"]
    assert not (tmp_path / "out" / "cluster.json").exists()
    assert not (tmp_path / "out" / "spool").exists()
    assert (kept.run / "cluster.json").exists()


def test_ctrl_c_stops_a_cluster_that_was_kept_with_exit_code_0(kept: Kept) -> None:
    children = family(kept.process.pid)
    assert len(children) > 6
    kept.process.send_signal(signal.SIGINT)
    assert kept.process.wait(60) == 0
    assert all_gone(children, within_s=1)
    assert not (kept.run / "cluster.json").exists()


def test_kill_minus_9_of_the_command_leaves_no_process(tmp_path: Path) -> None:
    with start("up", write_fleet(tmp_path, SLOW, seconds=600), cwd=tmp_path) as process:
        read_until(process, "frames processed")
        children = family(process.pid)
        assert len(children) > 4
        process.kill()
    assert all_gone(children, within_s=30)


def test_ctrl_c_breaks_a_batch_run_off_with_exit_code_130(tmp_path: Path) -> None:
    with start("up", write_fleet(tmp_path, SLOW, seconds=600), cwd=tmp_path) as process:
        read_until(process, "frames processed")
        children = family(process.pid)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
    assert all_gone(children, within_s=1)


def test_a_service_that_dies_ends_the_run_with_the_end_of_its_log(tmp_path: Path) -> None:
    fleet = write_fleet(tmp_path, 'slam.kernel = "crystal-ball"\n')
    done = call("up", fleet, cwd=tmp_path)
    assert done.returncode == 1
    assert "edge/edge-" in done.stderr
    assert "crystal-ball" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_robot_that_is_killed_does_not_end_the_run_and_is_named_with_its_last_frame(tmp_path: Path) -> None:
    with start("up", write_fleet(tmp_path, seconds=3000), cwd=tmp_path, RECSLAM_EDGE__LEASE_S="2") as process:
        read_until(process, " of 2 robots in ")
        (robot,) = [pid for pid in family(process.pid) if program(pid)[2:5] == ["services.robot_agent", "--id", "r2"]]
        os.kill(robot, signal.SIGKILL)
        said = read_until(process, "files ")
        assert process.wait(60) == 0
    found = report(tmp_path / "runs" / "latest")
    assert found["final"] is True
    assert isinstance(found["vanished"], dict)
    last = found["vanished"]["r2"]
    assert "r2 was killed by SIGKILL; after edge.lease_s = 2 s its map is final as it is" in said
    assert f"vanished   r2 at frame {last}: the map has what had come of it by then" in said
    assert len(read_trajectory(tmp_path / "runs" / "latest" / "robots" / "r2.tum")) == last + 1 < 16500


def program(pid: int) -> list[str]:
    """The command line of a process."""
    return Path(f"/proc/{pid}/cmdline").read_text().split("\0")


def test_ctrl_c_ends_a_live_fleet_with_exit_code_0_and_leaves_its_map(tmp_path: Path) -> None:
    with start("up", write_fleet(tmp_path, SLOW, seconds=600), cwd=tmp_path, RECSLAM_BATCH="false") as process:
        read_until(process, " of 2 robots in 1 component")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    run = tmp_path / "runs" / "latest"
    assert (read_map(run / "global_map.yaml").occupancy == 100).any()
    assert report(run)["final"] is False
