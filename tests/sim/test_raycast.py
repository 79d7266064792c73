"""Rays against walls: the compiled walk agrees with the plain one, and with a foreign physics engine."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.sim.index import SegmentIndex, cast_rays, cast_rays_numpy
from common.sim.lidar import disc_ranges
from common.sim.scene import load_scene
from common.sim.world import Plan, World


def random_plan(seed: int, boxes: int, extent: float) -> tuple[World, np.ndarray]:
    """A walled place with turned boxes (n, 5): centre x, y, width, height, turn."""
    rng = np.random.default_rng(seed)
    plan = Plan()
    plan.room(-extent, -extent, extent, extent, thickness=0.2)
    places = np.column_stack(
        [rng.uniform(-extent, extent, (boxes, 2)), rng.uniform(0.05, 2, (boxes, 2)), rng.uniform(0, 3, boxes)]
    )
    for x, y, width, height, turn in places:
        plan.box(x - width / 2, y - height / 2, width, height, turn)
    return plan.world(), places


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), boxes=st.integers(1, 40), limit=st.sampled_from([0.7, 3.5, 50.0]))
def test_the_walk_through_the_grid_finds_what_testing_every_wall_finds(seed: int, boxes: int, limit: float) -> None:
    world, _ = random_plan(seed, boxes, 8.0)
    rng = np.random.default_rng(seed)
    origins, angles = rng.uniform(-10, 10, (300, 2)), rng.uniform(-7, 7, 300)
    angles[:8] = np.arange(8) * np.pi / 4
    origins[:4] = np.round(origins[:4] * 2) / 2  # onto the borders of cells
    walked = world.index.cast(origins, angles, limit)
    np.testing.assert_allclose(walked, cast_rays_numpy(world.segments, origins, angles, limit), atol=1e-6)


def test_the_compiled_kernel_and_its_python_text_agree() -> None:
    world, _ = random_plan(3, 5, 4.0)
    index, rng = world.index, np.random.default_rng(1)
    origins, angles = rng.uniform(-3, 3, (40, 2)), rng.uniform(-4, 4, 40)
    parts = (index.segments, index.origin, index.cell, *index.shape, index.starts, index.members)
    np.testing.assert_allclose(cast_rays.py_func(*parts, origins, angles, 9.0), index.cast(origins, angles, 9.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ranges_agree_with_mujoco_to_a_millimetre(seed: int) -> None:
    mujoco = pytest.importorskip("mujoco")
    extent, reach = 8.0, 30.0
    world, places = random_plan(seed, 60, extent)
    geoms = [
        f'<geom type="box" pos="{x} {y} 0" size="{w / 2} {h / 2} 1" euler="0 0 {turn}"/>' for x, y, w, h, turn in places
    ]
    for side in (-extent, extent):
        geoms.append(f'<geom type="box" pos="{side} 0 0" size="0.1 {extent + 0.1} 1"/>')
        geoms.append(f'<geom type="box" pos="0 {side} 0" size="{extent + 0.1} 0.1 1"/>')
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{"".join(geoms)}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng, angles = np.random.default_rng(seed), np.linspace(-np.pi, np.pi, 720, endpoint=False)
    compared = 0
    for origin in rng.uniform(-extent + 0.5, extent - 0.5, (40, 2)):
        c, s = np.cos(-places[:, 4]), np.sin(-places[:, 4])
        x, y = origin[0] - places[:, 0], origin[1] - places[:, 1]
        near = np.maximum(np.abs(c * x - s * y) - places[:, 2] / 2, np.abs(s * x + c * y) - places[:, 3] / 2)
        if near.min() < 0:
            continue  # inside a box: a face seen from behind is a matter of taste
        rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(720)])
        distance, geom = np.zeros(720), np.zeros(720, np.int32)
        mujoco.mj_multiRay(
            model, data, np.array([*origin, 0.0]), rays.ravel(), None, 1, -1, geom, distance, None, 720, reach
        )
        ours = world.index.cast(np.tile(origin, (720, 1)), angles, reach)
        np.testing.assert_allclose(ours, distance, atol=1e-3)
        compared += 1
    assert compared >= 5


def test_a_ray_that_meets_nothing_within_reach_is_infinite() -> None:
    world = load_scene("two_rooms").world
    far = world.index.cast(np.array([[5.0, 3.9], [-50.0, 0.0]]), np.array([0.3, np.pi]), 0.5)
    assert np.isinf(far).all()


def test_a_huge_world_gets_coarser_cells_not_more_memory() -> None:
    index = SegmentIndex.of(np.array([[0.0, 0.0, 5000.0, 0.0], [0.0, 4000.0, 1.0, 4000.0]]))
    assert index.shape[0] * index.shape[1] < 5_000_000
    assert index.cast(np.array([[2500.0, 80.0]]), np.array([-np.pi / 2]), 100.0)[0] == pytest.approx(80.0)


def test_discs_are_met_on_their_near_side_and_not_from_within() -> None:
    origins, angles = np.zeros((4, 2)), np.array([0.0, np.pi, 0.0, 0.0])
    centres = np.array([[2.0, 0.0], [2.0, 0.0], [0.1, 0.0], [2.0, 0.16]])
    ranges = disc_ranges(origins, angles, centres, 0.15, 12.0)
    assert ranges[0] == pytest.approx(1.85)
    assert np.isinf(ranges[1:]).all()
