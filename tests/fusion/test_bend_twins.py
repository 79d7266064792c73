"""Compiled kernels of bending agree with plain numpy, written from their definitions."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from drawn_worlds import apartment, mapped
from test_bend import AWAY, HOME, WIDTH_M, drifted

from common.fusion import bend as bending
from common.fusion.bend import AROUND_M, MIN_WALLS, PATCH_M, ROOTED, Bend, bend, weigh_bent
from common.fusion.evidence import AGREES, CONTRADICTS, OUTSIDE, classify
from common.fusion.matchmap import MatchMap
from common.fusion.refine import refine
from common.fusion.settings import FusionSettings
from common.geometry import apply, between, compose, inverse

SETTINGS = FusionSettings()


@pytest.fixture(scope="module")
def pair() -> tuple[MatchMap, MatchMap, np.ndarray]:
    a = mapped(apartment(3, width_m=WIDTH_M), HOME, seed=1)
    return a, mapped(drifted(apartment(3, width_m=WIDTH_M), 0.003), AWAY, seed=2), between(HOME, AWAY)


def gap(pose: np.ndarray, other: np.ndarray, middle: np.ndarray) -> tuple[float, float]:
    """(m, rad) between two poses at `middle`."""
    away = between(compose(other, (*middle, 0.0)), compose(pose, (*middle, 0.0)))
    return float(np.hypot(away[0], away[1])), abs(float(away[2]))


def plainly_bent(a: MatchMap, b: MatchMap, rigid: np.ndarray) -> Bend:
    """`bend` from its definition."""
    points = b.sample.points
    places, owner = np.unique(np.floor(points / PATCH_M).astype(int), axis=0, return_inverse=True)
    middles = np.array([points[owner.ravel() == k].mean(axis=0) for k in range(len(places))])
    around = [b.sample.at(np.flatnonzero(((points - m) ** 2).sum(axis=1) < AROUND_M**2)) for m in middles]
    poses, walls = np.tile(rigid, (len(places), 1)), np.zeros(len(places), int)
    settled, queue = set(), []

    def fit(k: int, pose: np.ndarray) -> float:
        labels = classify(a, around[k], pose, SETTINGS)
        walls[k] = (labels != OUTSIDE).sum()
        return float((labels == AGREES).sum() / walls[k]) if walls[k] else 0.0

    for k in range(len(places)):
        share = fit(k, rigid)
        if share >= ROOTED and walls[k] >= MIN_WALLS:
            heapq.heappush(queue, (-share, k, tuple(rigid)))
    while queue:
        _, k, start = heapq.heappop(queue)
        if k in settled:
            continue
        settled.add(k)
        poses[k] = start
        if len(around[k].points) >= MIN_WALLS:
            found = refine(a, around[k], np.array(start), bending.REACH_M, bending.STEPS).pose
            step, total = gap(found, np.array(start), middles[k]), gap(found, rigid, middles[k])
            small = step[0] <= bending.STEP_M and step[1] <= bending.STEP_RAD
            if small and total[0] <= SETTINGS.max_bend_m and total[1] <= SETTINGS.max_bend_rad:
                poses[k] = found
        for near in np.flatnonzero((np.abs(places - places[k]) <= 1).all(axis=1)):
            if near not in settled:
                heapq.heappush(queue, (-fit(near, poses[k]), near, tuple(poses[k])))
    return Bend(middles, poses, walls)


def test_a_placement_is_carried_from_patch_to_patch_as_defined(pair) -> None:
    a, b, truth = pair
    found, plain = bend(a, b, truth, SETTINGS), plainly_bent(a, b, truth)
    assert np.allclose(found.middles, plain.middles)
    assert np.array_equal(found.walls, plain.walls)
    assert np.allclose(found.poses, plain.poses, atol=1e-6)
    assert np.ptp(found.poses[:, 2]) > 0.02


def test_every_wall_is_weighed_where_the_patch_nearest_to_it_lies(pair) -> None:
    a, b, truth = pair
    bent = bend(a, b, truth, SETTINGS)
    rigid = bent.poses[bent.walls.argmax()]
    agreeing, clashing = 0.0, 0
    for one, other, points, turned in (
        (a, b, b.sample.points, bent.poses),
        (b, a, apply(inverse(rigid), a.sample.points), inverse(bent.poses)),
    ):
        patch = ((points[:, None] - bent.middles) ** 2).sum(axis=2).argmin(axis=1)
        assert np.array_equal(bent.nearest(points), patch)
        labels = np.array(
            [classify(one, other.sample.at(np.array([k])), turned[patch[k]], SETTINGS)[0] for k in range(len(points))]
        )
        agreeing += (labels == AGREES).mean() * other.wall_m / 2
        clashing += int((labels == CONTRADICTS).sum())
    evidence = weigh_bent(a, b, bent, SETTINGS)
    assert evidence.agreeing_m == pytest.approx(agreeing)
    assert len(evidence.clashing) == clashing
