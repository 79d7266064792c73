"""Scenes are sound: nobody drives into a wall, every place is covered, fleets name what there is."""

from pathlib import Path

import numpy as np
import pytest

from common.config import SimSource, load
from common.errors import BadFile, ConfigError
from common.sim.motion import Pace, Style, drive
from common.sim.robot import SimulatedRobot
from common.sim.scene import BUILT_IN, Scene, load_scene
from common.sim.truth import visible_area

FLEETS = Path(__file__).parents[2] / "fleets"
SIZES = {
    "apartment": (13, 18), "symmetric": (4, 4), "asymmetric": (5, 5), "two_rooms": (22, 10), "factory": (60, 40),
    "office": (150, 100),
}  # fmt: skip


ROUTED = [(name, style) for name in BUILT_IN[:-1] for style in ("turn_then_go", "smooth")]
ROUTED += [("office", "turn_then_go"), ("office:3", "turn_then_go")]


@pytest.mark.parametrize(("name", "style"), ROUTED)
def test_no_route_comes_nearer_than_15_cm_to_a_wall(name: str, style: Style) -> None:
    scene = load_scene(name)
    every = 1.0 if name.startswith("office") else 0.1
    places = [
        track.turned(np.arange(0, track.duration, every))[:, :2]
        for track in (drive(way, Pace(1.0, 1.0), style) for way in scene.routes.values())
    ]
    cells = np.unique(np.round(np.vstack(places) / 0.02).astype(int), axis=0) * 0.02
    assert scene.world.clearance(cells).min() > 0.15 + 0.015


@pytest.mark.parametrize("name", BUILT_IN[:-1])
def test_robots_start_and_end_apart(name: str) -> None:
    routes = list(load_scene(name).routes.values())
    for ends in ([way[0] for way in routes], [way[-1] for way in routes]):
        gaps = np.hypot(*(np.array(ends)[:, None] - np.array(ends)).transpose(2, 0, 1)) + 9 * np.eye(len(ends))
        assert gaps.min() > 0.4


@pytest.mark.parametrize(("name", "size"), SIZES.items())
def test_scenes_have_the_size_they_are_named_for(name: str, size: tuple[float, float]) -> None:
    x0, y0, x1, y1 = load_scene(name).world.bounds
    assert (x1 - x0, y1 - y0) == pytest.approx(size, abs=0.4)


def area(scene: Scene, *robots: str) -> set[tuple[float, float]]:
    seen = visible_area(scene, [SimulatedRobot(scene, robot, 0) for robot in robots], 0.25)
    return set(map(tuple, np.round(seen, 3)))


def test_four_robots_cover_the_apartment_and_overlap() -> None:
    scene = load_scene("apartment")
    alone = [area(scene, robot) for robot in ("r1", "r2", "r3", "r4")]
    together, everybody = set().union(*alone), area(scene, *scene.routes)
    assert len(together) > 0.99 * len(everybody)
    assert all(len(seen) < 0.85 * len(together) for seen in alone)
    for one, other in ((0, 1), (1, 2), (2, 3)):
        assert len(alone[one] & alone[other]) > 0.25 * min(len(alone[one]), len(alone[other]))


def test_only_the_fifth_robot_joins_the_two_rooms() -> None:
    scene = load_scene("two_rooms")
    west, east = area(scene, "r1", "r2"), area(scene, "r3", "r4")
    assert len(west & east) < 0.08 * min(len(west), len(east))
    crossing = area(scene, "r5")
    assert len(crossing & west) > 0.5 * len(west)
    assert len(crossing & east) > 0.5 * len(east)


def test_the_symmetric_scene_looks_the_same_after_half_a_turn_and_no_other_small_one_does() -> None:
    def differs(name: str) -> bool:
        world = load_scene(name).world
        x0, y0, x1, y1 = world.bounds
        ends = world.segments.reshape(-1, 2)
        turned = [x0 + x1, y0 + y1] - ends
        gaps = np.hypot(*(ends[:, None] - turned).transpose(2, 0, 1)).min(axis=1)
        return bool(gaps.max() > 0.1)

    assert not differs("symmetric")
    assert all(differs(name) for name in ("apartment", "asymmetric", "prototype", "factory"))


def test_the_office_has_a_long_route_and_depends_on_its_seed() -> None:
    office = load_scene("office")
    assert np.hypot(*np.diff(office.waypoints("r1"), axis=0).T).sum() >= 1500
    np.testing.assert_array_equal(office.world.segments, load_scene("office:0").world.segments)
    assert not np.array_equal(office.world.segments[:50], load_scene("office:1").world.segments[:50])


@pytest.mark.parametrize("path", sorted(FLEETS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_simulated_fleet_loads_and_names_routes_that_there_are(path: Path) -> None:
    fleet = load(path)
    assert fleet.edges
    for entry in fleet.robots:
        if isinstance(entry.source, SimSource):
            scene = load_scene(entry.source.scene)
            scene.waypoints(entry.source.route or entry.id)
            if entry.start is not None:
                pace = Pace(entry.source.speed_mps, entry.source.turn_radps)
                pose = scene.track(entry.id, fleet.seed, pace, entry.source.route).at([0.0])[0]
                np.testing.assert_allclose(entry.start, pose, atol=1e-3)


def test_unknown_scenes_and_routes_are_refused_with_what_there_is() -> None:
    with pytest.raises(ConfigError, match=r"castle.*apartment"):
        load_scene("castle")
    with pytest.raises(ConfigError, match="apartment:2"):
        load_scene("apartment:2")
    with pytest.raises(ConfigError, match=r"r99.*r10"):
        load_scene("apartment").waypoints("r99")
    with pytest.raises(BadFile, match=r"gone\.yaml"):
        load_scene("/gone.yaml")
