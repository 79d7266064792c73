"""Solving finds the truth from pairs in any order, names the pair that lies, and keeps the world where it was."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.fusion.cycles import Measurement, Pair
from common.fusion.solve import Solved, solve
from common.geometry import between, compose, wrap

NAMES = ("ant", "bee", "cat", "dog", "elk", "fox")


def truth(seed: int, names: tuple[str, ...] = NAMES) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: np.array([*rng.uniform(-20, 20, 2), rng.uniform(-np.pi, np.pi)]) for name in names}


def all_pairs(poses: dict[str, np.ndarray], noise: float = 0.0) -> dict[Pair, Measurement]:
    rng = np.random.default_rng(9)
    return {
        (a, b): Measurement(between(poses[a], poses[b]) + rng.normal(0, noise, 3) * (1, 1, 0.1))
        for a, b in itertools.combinations(poses, 2)
    }


def assert_places(component: Solved, poses: dict[str, np.ndarray], tolerance: float = 1e-6) -> None:
    first = component.robots[0]
    for name in component.robots:
        got = between(component.transforms[first], component.transforms[name])
        gap = got - between(poses[first], poses[name])
        assert np.hypot(gap[0], gap[1]) < tolerance
        assert abs(wrap(gap[2])) < tolerance


@given(st.integers(0, 50), st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_the_truth_comes_out_of_any_order_of_the_pairs(seed: int, random) -> None:
    poses = truth(seed)
    pairs = list(all_pairs(poses).items())
    random.shuffle(pairs)
    chosen = dict(pairs[:9])
    for component in solve(NAMES, chosen):
        assert_places(component, poses)
    assert np.array_equal(
        [c.transforms[r] for c in solve(NAMES, chosen) for r in c.robots],
        [c.transforms[r] for c in solve(NAMES[::-1], dict(sorted(chosen.items()))) for r in c.robots],
    )


def test_pairs_may_be_given_either_way_round() -> None:
    poses = truth(3)
    pairs = {(b, a): Measurement(between(poses[b], poses[a])) for a, b in all_pairs(poses)}
    (component,) = solve(NAMES, pairs)
    assert_places(component, poses)


def test_noise_averages_out_over_the_graph() -> None:
    poses = truth(4)
    (component,) = solve(NAMES, all_pairs(poses, noise=0.03))
    assert_places(component, poses, tolerance=0.08)


@pytest.mark.parametrize("liar", list(itertools.combinations(NAMES[:5], 2)))
def test_the_pair_that_breaks_the_cycles_is_left_out_and_named(liar: Pair) -> None:
    poses = truth(5, NAMES[:5])
    pairs = all_pairs(poses, noise=0.01)
    pairs[liar] = Measurement(compose(pairs[liar].transform, (3.0, -1.0, 0.4)), 100 * Measurement(None).information)
    (component,) = solve(NAMES[:5], pairs)
    assert set(component.left_out) == {liar}
    assert "misses its start by" in component.left_out[liar]
    assert_places(component, poses, tolerance=0.05)


def test_robots_that_share_nothing_are_components_of_their_own() -> None:
    poses = truth(6)
    pairs = all_pairs(poses)
    kept = {pair: pairs[pair] for pair in [("ant", "cat"), ("bee", "dog")]} | {("elk", "fox"): Measurement(None)}
    assert [c.robots for c in solve(NAMES, kept)] == [("ant", "cat"), ("bee", "dog"), ("elk",), ("fox",)]
    assert all(c.id == c.robots[0] and not c.transforms[c.id].any() for c in solve(NAMES, kept))


def test_start_poses_join_robots_that_share_nothing() -> None:
    poses = truth(7)
    (component,) = solve(NAMES[:3], {}, starts={name: poses[name] for name in NAMES[:3]})
    assert component.in_world
    assert all(np.allclose(component.transforms[name], poses[name]) for name in NAMES[:3])


def test_a_measured_pair_outweighs_start_poses() -> None:
    poses = truth(8, NAMES[:2])
    told = {"ant": poses["ant"], "bee": poses["bee"] + (0.3, 0.1, 0.05)}
    (component,) = solve(NAMES[:2], all_pairs(poses), starts=told)
    assert_places(component, poses, tolerance=0.05)


def test_anchors_keep_the_published_world_where_it_was() -> None:
    poses = truth(9)
    world = {name: poses[name] for name in NAMES[1:]}
    stray = {"ant": compose(poses["ant"], (50.0, 0.0, 1.0))}
    (component,) = solve(NAMES, all_pairs(poses), anchors=world | stray)
    for name in NAMES:
        assert np.allclose(component.transforms[name], poses[name], atol=1e-6)
