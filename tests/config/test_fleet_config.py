"""A configuration is taken whole or refused by the name of the field."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.config import dump, load
from common.errors import ConfigError

FLEET = """
name = "lab"
[bus]
endpoint = "tcp/10.0.0.1:7447"
[edge]
window = 32
[[robots]]
id = "r1"
source = { kind = "sim", scene = "apartment" }
[[edges]]
id = "e1"
"""


@pytest.fixture
def fleet_file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    return path


def test_what_the_file_leaves_out_has_its_default(fleet_file: Path) -> None:
    fleet = load(fleet_file)
    assert (fleet.edge.window, fleet.edge.map_every_s, fleet.topology) == (32, 2.0, "recslam")


def test_the_environment_goes_before_the_file_and_leaves_its_neighbours_alone(
    fleet_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RECSLAM_EDGE__MAP_EVERY_S", "0.5")
    fleet = load(fleet_file)
    assert (fleet.edge.map_every_s, fleet.edge.window) == (0.5, 32)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[bus]\nendpiont = 'tcp/a:1'", "bus.endpiont"),
        ("topology = 'star'", "topology"),
        ("[edge]\nwindow = 0", "edge.window"),
        ("[[robots]]\nid = 'r 1'\nsource = { kind = 'sim', scene = 'apartment' }", "robots.0.id"),
        ("[[robots]]\nid = 'r1'\nsource = { kind = 'film', scene = 'apartment' }", "robots.0.source"),
        (
            "[[robots]]\nid = 'r1'\nsource = { kind = 'sim', scene = 'apartment', noise = 'loud' }",
            "robots.0.source.sim.noise",
        ),
        (
            "[[robots]]\nid = 'r1'\nsource = { kind = 'sim', scene = 'apartment' }\nstart = [0.0, 0.0, nan]",
            "robots.0.start.2",
        ),
        ("[edge]\nlease_s = inf", "edge.lease_s"),
        ("[[edges]]\nid = 'e'\n[[edges]]\nid = 'e'", "toml: edges: e named twice"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, text: str, field: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=field.replace(".", r"\.")) as told:
        load(path)
    assert str(path) in str(told.value)


def test_a_file_that_is_missing_or_no_toml_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: no such file"):
        load(tmp_path / "nowhere.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(ConfigError, match=r"broken\.toml"):
        load(broken)


def test_a_typing_error_in_the_environment_does_not_pass_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RECSLAM_EGDE__WINDOW", "5")
    with pytest.raises(ConfigError, match="RECSLAM_EGDE__WINDOW"):
        load(None)


def test_a_section_in_the_environment_that_is_no_section_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RECSLAM_SLAM", "gmapping")
    with pytest.raises(ConfigError, match="RECSLAM_SLAM__KERNEL=gmapping"):
        load(None)


def test_a_robot_that_no_entry_names_takes_the_default_or_is_refused(tmp_path: Path, fleet_file: Path) -> None:
    with pytest.raises(ConfigError, match="no entry for 'r9'"):
        load(fleet_file).robot_entry("r9")
    path = tmp_path / "scaled.toml"
    path.write_text("default_robot = { scene = 'apartment' }")
    assert load(path).robot_entry("r9").source.kind == "sim"


def test_the_effective_configuration_can_be_dumped_as_plain_data(fleet_file: Path) -> None:
    assert dump(load(fleet_file))["robots"][0]["source"]["scene"] == "apartment"
