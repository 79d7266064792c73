"""Maps that drift has bent are merged where a rigid placement would be contradicted; other places still are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from drawn_worlds import RESOLUTION, Counts, apartment, mapped

from common.fusion.bend import STIFF, bend, loosened, weigh_bent
from common.fusion.evidence import weigh
from common.fusion.match import Match, match, track
from common.fusion.settings import FusionSettings
from common.geometry import between, compose

HOME, AWAY = np.array([3.0, 2.0, 0.3]), np.array([-4.0, 7.0, 2.0])
RIGID = FusionSettings(min_bent_score_m=1e6)
WIDTH_M = 40.0


def drifted(counts: Counts, curvature: float, straight_m: float = WIDTH_M / 2) -> Counts:
    """The world as a robot maps it whose heading drifts by so many rad per metre after `straight_m`."""
    rows, columns = np.mgrid[: counts.shape[1], : counts.shape[2]].astype(np.float32)
    along = np.maximum(columns * RESOLUTION - straight_m, 0)
    rows += (0.5 * curvature * along**2 / RESOLUTION).astype(np.float32)
    return np.stack([cv2.remap(plane, columns, rows, cv2.INTER_NEAREST) for plane in counts])


def pair(curvature: float, other: int = 3) -> Match:
    a = mapped(apartment(3, width_m=WIDTH_M), HOME, seed=1)
    return match(a, mapped(drifted(apartment(other, width_m=WIDTH_M), curvature), AWAY, seed=2))


@pytest.mark.parametrize("curvature", [0.002, 0.003])
def test_a_bent_map_is_merged_although_no_rigid_placement_fits(curvature: float) -> None:
    a = mapped(apartment(3, width_m=WIDTH_M), HOME, seed=1)
    b = mapped(drifted(apartment(3, width_m=WIDTH_M), curvature), AWAY, seed=2)
    assert match(a, b, settings=RIGID).kind != "merged"
    found = match(a, b)
    assert found.kind == "merged", found.reason
    assert "bending" in found.reason
    assert found.transform is not None
    gap = compose(HOME, found.transform) - AWAY
    assert np.hypot(gap[0], gap[1]) < 0.5
    assert track(a, b, found.transform).kind == "merged"


def test_another_building_is_not_bent_until_it_fits() -> None:
    for other in (50, 51, 52):
        assert pair(0.003, other).kind != "merged"


def test_bending_explains_contradictions() -> None:
    a = mapped(apartment(3, width_m=WIDTH_M), HOME, seed=1)
    b = mapped(drifted(apartment(3, width_m=WIDTH_M), 0.003), AWAY, seed=2)
    pose, settings = between(HOME, AWAY), FusionSettings()
    rigid, bent = weigh(a, b, pose, settings), weigh_bent(a, b, bend(a, b, pose, settings), settings)
    assert bent.conflicting_m < 0.3 * rigid.conflicting_m
    assert bent.agreeing_m > rigid.agreeing_m


def test_a_bent_pair_is_less_sure_than_a_straight_one_and_none_is_surer_than_maps_are_straight() -> None:
    pose, settings = between(HOME, AWAY), FusionSettings()
    a = mapped(apartment(3, width_m=WIDTH_M), HOME, seed=1)
    unsure = []
    for curvature in (0.0, 0.003):
        b = mapped(drifted(apartment(3, width_m=WIDTH_M), curvature), AWAY, seed=2)
        information = loosened(np.diag([1e6, 1e6, 1e8]), b, pose, bend(a, b, pose, settings))
        unsure.append(np.sqrt(np.diag(np.linalg.inv(information))))
    assert (unsure[0] >= np.sqrt(np.diag(STIFF))).all()
    assert unsure[1][2] > 1.5 * unsure[0][2]


def test_a_map_stretched_along_a_corridor_is_known_less_surely_along_it() -> None:
    world, middle = apartment(3, width_m=WIDTH_M), np.array([WIDTH_M / 2, 6.0, 0.0])
    rows, columns = np.mgrid[: world.shape[1], : world.shape[2]].astype(np.float32)
    columns -= np.float32(0.02) * np.maximum(columns - np.float32(28.0 / RESOLUTION), 0)
    stretched = np.stack([cv2.remap(plane, columns, rows, cv2.INTER_NEAREST) for plane in world])
    a = mapped(world, np.zeros(3), seed=1)
    straight, along = (track(a, mapped(counts, middle, seed=2), middle) for counts in (world, stretched))
    assert along.agreement > 0.9
    (x, y, _), (along_x, along_y, _) = (np.sqrt(np.diag(np.linalg.inv(f.information))) for f in (straight, along))
    assert along_x > 2 * x
    assert along_y < 1.1 * y
