"""Tracks keep the pace, pass their waypoints, and are functions of scene, seed and name alone."""

import os
import subprocess
import sys

import numpy as np
import pytest

from common.errors import ConfigError
from common.geometry import wrap
from common.sim.motion import Pace, Style, drive
from common.sim.scene import load_scene

ZIGZAG = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.5], [0.5, 1.5], [2.0, 1.4], [2.0, 1.4], [5.0, 3.0]])


@pytest.mark.parametrize("style", ["turn_then_go", "smooth"])
def test_speed_and_turn_rate_stay_within_the_pace(style: Style) -> None:
    pace = Pace(0.4, 0.7)
    track = drive(ZIGZAG, pace, style)
    poses = track.turned(np.arange(0, track.duration, 0.01))
    speed, rate = np.hypot(*np.diff(poses[:, :2], axis=0).T) / 0.01, np.abs(np.diff(poses[:, 2])) / 0.01
    assert 0.35 < speed.max() <= pace.speed_mps * 1.01
    assert 0.6 < rate.max() <= pace.turn_radps * 1.01
    assert np.abs(np.diff(speed)).max() / 0.01 < 60  # no leaps: at most the ramp's acceleration over one tick


def test_turn_then_go_passes_every_waypoint_and_faces_the_way_it_drives() -> None:
    track = drive(ZIGZAG, Pace())
    poses = track.at(np.arange(0, track.duration + 0.05, 0.02))
    for waypoint in ZIGZAG:
        assert np.hypot(*(poses[:, :2] - waypoint).T).min() < 0.01
    step = np.diff(poses[:, :2], axis=0)
    moving = np.hypot(*step.T) > 1e-3
    heading = np.arctan2(step[:, 1], step[:, 0])
    off = np.abs(wrap(heading - poses[:-1, 2]))[moving]
    assert np.median(off) < 1e-6
    assert off.max() < np.pi / 2


def test_smooth_cuts_corners_by_no_more_than_its_radius() -> None:
    corner = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]])
    track = drive(corner, Pace(), "smooth")
    poses = track.at(np.arange(0, track.duration, 0.02))
    nearest = np.hypot(*(poses[:, :2] - corner[1]).T).min()
    assert 0.05 < nearest < 0.3 * (np.sqrt(2) - 1) + 0.01
    assert drive(corner, Pace()).duration > track.duration


def test_a_robot_stands_still_before_and_after_its_route() -> None:
    track = drive(ZIGZAG, Pace())
    np.testing.assert_array_equal(track.at([-5.0])[0, :2], ZIGZAG[0])
    np.testing.assert_allclose(track.at([track.duration + 100])[0, :2], ZIGZAG[-1])


def test_a_route_of_one_place_is_refused() -> None:
    with pytest.raises(ConfigError, match="two different waypoints"):
        drive([[1.0, 1.0], [1.0, 1.0]], Pace())
    with pytest.raises(ConfigError, match="positive"):
        Pace(0.0)


@pytest.mark.parametrize("name", ["apartment", "two_rooms", "asymmetric"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_walks_keep_off_the_walls(name: str, seed: int) -> None:
    scene = load_scene(name)
    track = scene.track("wanderer", seed, Pace(), duration_s=200.0)
    assert track.duration >= 200.0
    assert scene.world.clearance(track.at(np.arange(0, 200, 0.1))[:, :2]).min() > 0.2


def test_walks_of_other_names_and_seeds_differ() -> None:
    scene, times = load_scene("apartment"), np.arange(0, 60, 1.0)
    walks = [scene.track(name, seed, Pace(), duration_s=60).at(times) for name, seed in (("a", 0), ("b", 0), ("a", 1))]
    assert all(np.abs(walks[i] - walks[j]).max() > 1 for i, j in ((0, 1), (0, 2), (1, 2)))


def test_a_longer_walk_begins_with_the_shorter_one() -> None:
    scene, times = load_scene("apartment"), np.arange(0, 90.0, 0.1)
    short, long = (scene.track("a", 5, Pace(), duration_s=duration).at(times) for duration in (90.0, 400.0))
    np.testing.assert_array_equal(short, long)


def test_another_process_agrees_where_a_robot_is() -> None:
    code = (
        "from common.sim.scene import load_scene; from common.sim.motion import Pace;"
        "print(load_scene('two_rooms').track('a', 9, Pace(), duration_s=50).at([41.5]).tobytes().hex())"
    )
    hashed = {**os.environ, "PYTHONHASHSEED": "1"}
    told = subprocess.run([sys.executable, "-c", code], env=hashed, capture_output=True, text=True).stdout.strip()
    here = load_scene("two_rooms").track("a", 9, Pace(), duration_s=50).at([41.5])
    assert told == here.tobytes().hex()
