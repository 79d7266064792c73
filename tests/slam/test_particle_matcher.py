"""Promises of `gmapping`'s tracking from frame to frame, where dead reckoning is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from gmapping_cases import BEAMS, ranges_at

from services.edge_worker.slam.gmapping.particle_matcher import ParticleMatcher, Uncertainty
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.gmapping.settings import GMappingSettings

SURE = Uncertainty(0.02, 0.03)
"""of dead reckoning, m and rad"""
POSE = np.array([0.4, 0.5, 0.0])


def points_at(pose: np.ndarray) -> np.ndarray:
    """The ends (BEAMS, 2) of a scan in the furnished room, in the base frame."""
    angles = -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
    return (ranges_at(pose)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float32)


def a_matcher(views: list[tuple[np.ndarray, np.ndarray]]) -> ParticleMatcher:
    """On a map of scans (n, 2), each taken at a pose (3,)."""
    settings = GMappingSettings()
    maps = PatchMap(1, settings.resolution_m)
    for points, pose in views:
        maps.cover_scan(points, pose[None], 2.0)
        maps.add(points, pose[None])
    return ParticleMatcher(settings, maps)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.45), (0.04, -0.04, 0.35), (-0.03, 0.03, -0.4)])
def test_a_scan_is_found_where_dead_reckoning_is_sure_and_wrong(off: tuple[float, float, float]) -> None:
    around = [POSE + shift for shift in (-0.1, 0.0, 0.1)]
    matcher = a_matcher([(points_at(pose), pose) for pose in around])
    pose, matched = matcher.track(points_at(POSE), POSE + off, SURE, 0)
    assert matched
    assert np.abs(pose - POSE).max() < 0.02


def test_a_scan_of_which_half_is_new_stays_where_dead_reckoning_has_it() -> None:
    """Further back in the corridor more of it would find walls."""
    matcher = a_matcher([(corridor(-4.0, 1.0), np.zeros(3))])
    ahead = np.array([0.1, 0.0, 0.0])
    pose, matched = matcher.track(corridor(-1.6, 3.4), ahead, SURE, 0)
    assert matched
    assert np.abs(pose - ahead).max() < 0.05


def corridor(begin: float, end: float) -> np.ndarray:
    """Points (n, 2) on both walls of a corridor, 2 m wide, along x."""
    x = np.arange(begin, end, 0.06)
    return np.concatenate([np.stack([x, np.full(len(x), y)], axis=1) for y in (-1.0, 1.0)]).astype(np.float32)
