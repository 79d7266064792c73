"""Which edges a topology has, and what is started for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.config import Fleet, load
from common.errors import ConfigError
from services.command import fleets
from services.command.topology import arrange, programs


def apartment(topology: str) -> Fleet:
    return fleets.load_fleet("apartment", topology=topology)


def test_the_systems_own_topology_takes_the_edges_of_the_file() -> None:
    assert arrange(apartment("recslam")).edge_ids() == ("edge-1", "edge-2")


def test_single_edge_takes_the_first_edge_for_all() -> None:
    assert arrange(apartment("single-edge")).edge_ids() == ("edge-1",)


def test_cloud_puts_an_edge_beside_every_robot_which_reaches_no_other() -> None:
    fleet = arrange(apartment("cloud"))
    assert fleet.edge_ids() == ("edge-r1", "edge-r2", "edge-r3", "edge-r4")
    assert [robot.edges for robot in fleet.robots] == [(edge,) for edge in fleet.edge_ids()]


def test_local_is_for_one_robot() -> None:
    fleet = apartment("local")
    with pytest.raises(ConfigError, match="r1, r2, r3, r4"):
        arrange(fleet)
    alone = arrange(fleets.revised(fleet, robots=fleet.robots[:1]))
    assert alone.edge_ids() == ("edge-r1",)


def test_edge_only_runs_the_cloud_merger_beside_the_first_edge(tmp_path: Path) -> None:
    fleet = arrange(apartment("edge-only"))
    started = list(programs(fleet, tmp_path))
    cloud = next(program for program in started if program.name == "cloud")
    assert cloud.beside == "edge/edge-1"
    assert started.index(cloud) > [program.name for program in started].index("edge/edge-1")


@pytest.mark.parametrize("lacking", ["robots", "edges"])
def test_a_fleet_without_robots_or_edges_is_refused(lacking: str) -> None:
    with pytest.raises(ConfigError, match=f"{lacking}: none"):
        arrange(fleets.revised(apartment("recslam"), **{lacking: ()}))


@pytest.mark.parametrize(("reach", "said"), [(("edge-1", "egde-2"), "egde-2"), ((), "none within reach")])
def test_a_robot_that_would_wait_for_an_edge_that_nobody_starts_is_refused(reach: tuple[str, ...], said: str) -> None:
    fleet = apartment("recslam")
    first = fleet.robots[0].model_copy(update={"edges": reach})
    with pytest.raises(ConfigError, match=f"{first.id}: edges: .*{said}.*edge-1, edge-2"):
        arrange(fleets.revised(fleet, robots=(first, *fleet.robots[1:])))


@pytest.mark.parametrize("name", fleets.built_in())
def test_fleets_that_come_along_load_and_come_back_from_their_file(name: str, tmp_path: Path) -> None:
    fleet = fleets.load_fleet(name)
    fleets.write(fleet, tmp_path / "again.toml")
    assert load(tmp_path / "again.toml") == fleet


def test_the_command_line_goes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RECSLAM_TOPOLOGY", "cloud")
    assert fleets.load_fleet("apartment").topology == "cloud"
    assert fleets.load_fleet("apartment", topology="single-edge").topology == "single-edge"


def test_a_value_that_is_none_is_refused_by_its_name() -> None:
    with pytest.raises(ConfigError, match="topology"):
        fleets.revised(Fleet(), topology="star")
    with pytest.raises(ConfigError, match="scheduler"):
        fleets.revised(Fleet(), scheduler={"kappa": 0})


def test_the_fleet_file_of_the_readme_loads(tmp_path: Path) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    path = tmp_path / "readme.toml"
    path.write_text(readme.split("```toml\n")[1].split("```")[0])
    assert [robot.id for robot in arrange(load(path)).robots] == ["r1", "r2"]
