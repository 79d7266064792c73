"""Lasers see what is there from where they are at each beam's time, and err as their settings say."""

import numpy as np
import pytest

from common.errors import ConfigError
from common.geometry import compose
from common.sim.lidar import LIDARS, Disc, lidar_named, true_ranges
from common.sim.motion import Pace, drive
from common.sim.scene import load_scene
from common.sim.track import Track

SCENE = load_scene("apartment")
TRACK = SCENE.track("r1", 0, Pace(1.0, 1.5))


def still(x: float, y: float, theta: float = 0.0) -> Track:
    return Track(np.array([0.0]), np.array([[x, y, theta]]))


@pytest.mark.parametrize(("name", "beams", "reach", "rate"), [
    ("lds01", 360, 3.5, 5.0), ("rplidar_a1", 360, 12.0, 5.5), ("sick", 180, 80.0, 10.0),
    ("urg04lx", 683, 5.6, 10.0), ("utm30lx", 1081, 30.0, 10.0),
])  # fmt: skip
def test_lasers_are_what_their_makers_say(name: str, beams: int, reach: float, rate: float) -> None:
    lidar = lidar_named(name)
    assert (lidar.beams, lidar.geometry.range_max, lidar.rate_hz) == (beams, reach, rate)
    assert lidar.offsets()[-1] <= lidar.period


def test_each_beam_is_cast_from_where_the_laser_is_at_its_own_time() -> None:
    lidar = lidar_named("rplidar_a1").mounted((0.05, -0.02, 0.3))
    times = np.arange(5.0, 20.0, 0.7)
    for stamp in times:
        ranges = true_ranges(SCENE.world, lidar, TRACK, stamp, [])
        for beam in (0, 100, 359):
            base = TRACK.at([stamp + beam * lidar.geometry.time_increment])[0]
            laser = compose(base, lidar.geometry.mount)
            angle = laser[2] + lidar.geometry.angle_min + beam * lidar.geometry.angle_increment
            assert ranges[beam] == pytest.approx(SCENE.world.index.cast(laser[None, :2], np.array([angle]), 12.0)[0])


def test_noise_grows_with_range_and_drop_outs_come_at_their_rate() -> None:
    lidar, rng = LIDARS["rplidar_a1"], np.random.default_rng(0)
    seen = {true: np.array([lidar.spoil(np.full(360, true), rng) for _ in range(200)]) for true in (0.4, 4.0, 10.0)}
    spread = [np.nanstd(values) for values in seen.values()]
    assert spread == pytest.approx([0.005, 0.04, 0.06], rel=0.05)
    assert all(np.nanmean(values) == pytest.approx(true, abs=0.001) for true, values in seen.items())
    assert np.isnan(seen[4.0]).mean() == pytest.approx(lidar.drop_out, rel=0.1)


def test_too_far_is_plus_infinity_and_too_near_minus_infinity() -> None:
    lidar, rng = LIDARS["lds01"], np.random.default_rng(0)
    far, near = lidar.spoil(np.full(360, np.inf), rng), lidar.spoil(np.full(360, 0.02), rng)
    assert set(far[~np.isnan(far)]) == {np.inf}
    assert set(near[~np.isnan(near)]) == {-np.inf}
    assert far.dtype == np.float32
    edge = lidar.spoil(np.full(360, 3.5), rng)
    assert np.nanmax(edge[np.isfinite(edge)]) <= 3.5


def test_robots_see_each_other_where_they_are_at_that_time() -> None:
    lidar, me = LIDARS["rplidar_a1"], still(2.9, 1.2)
    peer = Disc(drive([[5.0, 2.2], [5.9, 3.2]], Pace(0.5)), 0.15)
    for stamp in (0.0, 1.5, 3.0):
        bare = true_ranges(SCENE.world, lidar, me, stamp, [])
        ranges = true_ranges(SCENE.world, lidar, me, stamp, [peer])
        shadow = np.flatnonzero(ranges < bare)
        times = stamp + shadow * lidar.geometry.time_increment
        angles = lidar.angles()[shadow]
        points = np.array([2.9, 1.2]) + ranges[shadow, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        assert 3 <= len(shadow) < 30
        np.testing.assert_allclose(np.hypot(*(points - peer.track.at(times)[:, :2]).T), 0.15, atol=1e-9)


def test_a_robot_that_stands_in_another_does_not_see_it() -> None:
    lidar, me = LIDARS["rplidar_a1"], still(2.9, 1.2)
    bare = true_ranges(SCENE.world, lidar, me, 0.0, [])
    within = true_ranges(SCENE.world, lidar, me, 0.0, [Disc(still(3.0, 1.2), 0.15)])
    np.testing.assert_array_equal(bare, within)


def test_an_unknown_laser_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"hokuyo.*sick"):
        lidar_named("hokuyo")
