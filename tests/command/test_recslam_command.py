"""What the command says when it cannot do what it is asked."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import call, write_fleet

NOBODY = "tcp/127.0.0.1:9"


def test_a_bad_key_of_a_fleet_file_is_exit_code_2_and_named(tmp_path: Path) -> None:
    done = call("up", write_fleet(tmp_path, "edge.wrokers = 2\n"), cwd=tmp_path)
    assert done.returncode == 2
    assert "pair.toml" in done.stderr
    assert "edge.wrokers" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "runs").exists()


def test_a_fleet_that_does_not_exist_is_exit_code_2_and_those_that_come_along_are_named(tmp_path: Path) -> None:
    done = call("up", "apratment", cwd=tmp_path)
    assert done.returncode == 2
    assert "apratment" in done.stderr
    assert "apartment, " in done.stderr


def test_a_misspelt_environment_variable_is_exit_code_2_and_named(tmp_path: Path) -> None:
    done = call("up", "apartment", cwd=tmp_path, RECSLAM_TOPLOGY="cloud")
    assert done.returncode == 2
    assert "RECSLAM_TOPLOGY" in done.stderr


@pytest.mark.parametrize("command", [["status"], ["doctor"], ["map", "save", "out"], ["why", "r1", "r2"]])
def test_without_a_router_a_command_ends_soon_with_exit_code_2_and_names_the_endpoint(
    command: list[str], tmp_path: Path
) -> None:
    done = call(*command, "--endpoint", NOBODY, cwd=tmp_path)
    assert done.returncode == 2
    assert f"no router at {NOBODY} within 3 s" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_endpoint_is_taken_from_the_environment_where_no_cluster_runs(tmp_path: Path) -> None:
    done = call("status", cwd=tmp_path, RECSLAM_ENDPOINT=NOBODY)
    assert (done.returncode, NOBODY in done.stderr) == (2, True)
    assert "comes from $RECSLAM_ENDPOINT" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("noise.log", bytes(range(256)) * 40, "noise.log"),
        ("empty.log", b"# nothing\n", "empty.log"),
        ("short.log", b"FLASER 180 1.0 2.0\n", "holds no usable FLASER row"),
        ("missing.log", None, "no such file"),
    ],
)
def test_a_log_that_cannot_be_read_is_exit_code_2_and_named(
    name: str, content: bytes | None, said: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    done = call("replay", name, "--robots", 2, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_that_is_no_recording_is_exit_code_2(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    done = call("replay", "empty", cwd=tmp_path)
    assert done.returncode == 2
    assert "is no recorded run" in done.stderr


def test_a_run_that_kept_no_frames_is_exit_code_2_and_what_keeps_them_is_named(tmp_path: Path) -> None:
    (tmp_path / "run" / "spool").mkdir(parents=True)
    write_fleet(tmp_path).rename(tmp_path / "run" / "fleet.toml")
    done = call("replay", "run", cwd=tmp_path)
    assert done.returncode == 2
    assert "r1.spool" in done.stderr
    assert "robot.record = true" in done.stderr
    for name in ("r1", "r2"):
        (tmp_path / "run" / "spool" / f"{name}.spool").touch()
    done = call("replay", "run", "--robots", 3, cwd=tmp_path)
    assert done.returncode == 2
    assert "--robots: run is of 2 robots" in done.stderr


def test_a_folder_that_cannot_be_made_is_exit_code_2_and_named(tmp_path: Path) -> None:
    done = call("record", write_fleet(tmp_path, seconds=1), "--out", "/proc/nowhere", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "recslam: /proc/nowhere: No such file or directory\n"


def test_a_recording_that_was_broken_off_is_not_gone_on_with(tmp_path: Path) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "r1.spool").touch()
    done = call("record", write_fleet(tmp_path, seconds=1), "--out", "half", cwd=tmp_path)
    assert done.returncode == 2
    assert "half: holds a recording that was broken off" in done.stderr


def test_a_service_refuses_what_it_does_not_know_by_itself(tmp_path: Path) -> None:
    done = call("edge", "--id", "edge-1", "--config", "apratment", cwd=tmp_path)
    assert (done.returncode, "apratment" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("services.cli", {"numpy", "zenoh", "numba", "cv2", "scipy", "rich.live"}),
        ("services.robot_agent.app", {"numba", "cv2", "scipy", "networkx"}),
    ],
)
def test_importing_costs_no_more_than_it_must(module: str, heavy: set[str]) -> None:
    program = f"import sys, {module}; print(*sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
