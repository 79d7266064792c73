"""Every move of the world frame is named, and a merge can be undone."""

from __future__ import annotations

import pytest
from cloud_samples import cover, edge_notice, map_notice, routes

from common.wire import FixedPose, Placed, Transforms
from services.cloud_merger.changes import changed, parted, reason
from services.cloud_merger.events import (
    Compose,
    Composed,
    EdgeMapNoticed,
    FetchPart,
    FetchSketch,
    MapNoticed,
    PartFetched,
    Routed,
    SketchFetched,
    Solve,
    Solved,
    Tick,
)
from services.cloud_merger.state import CloudState


def world(x_m: float = 0.0, **components: str) -> dict[str, Placed]:
    """Robots in these components; the last one lies at x."""
    last = max(components)
    return {
        robot: Placed(transform=FixedPose.of(x_m if robot == last else 0.0, 0, 0), component=home, version=1)
        for robot, home in components.items()
    }


def transforms(epoch: int, robots: dict[str, Placed]) -> Transforms:
    return Transforms(world_epoch=epoch, final=False, resolution=0.05, robots=robots, components=())


MERGED, APART = world(a="a", b="a", c="a"), world(a="a", b="b", c="b")


@pytest.mark.parametrize(
    ("now", "told"),
    [
        (MERGED, ""),
        (world(0.019, a="a", b="a", c="a"), ""),
        (world(0.3, a="a", b="a", c="a"), "correction: c by 0.300 m and 0.00 deg"),
        (APART, "un-merged: b and c from a"),
        (world(a="a", b="a"), "c has gone"),
        (world(a="a", b="a", c="a", d="d"), "d has come"),
    ],
)
def test_what_moves_the_world_is_named(now: dict[str, Placed], told: str) -> None:
    assert reason(now, MERGED, was_final=False, final=False) == told


def test_what_slam_moves_within_a_robot_map_is_named_though_the_world_stays() -> None:
    before = {"a": cover(5), "b": cover(5)}
    now = {"a": cover(9, corrections=2, corrected_m=0.0651), "b": cover(9)}
    assert changed(now, before) == ("SLAM corrected the map of a by up to 0.065 m, the last of 2",)
    assert changed(now, now) == ()


def test_a_map_that_another_instance_made_and_one_that_has_come_or_gone_are_named() -> None:
    before = {"a": cover(5, corrections=3)}
    assert changed({"a": cover(5, epoch=(1, 2))}, before) == ("the map of a was made anew",)
    assert changed({"a": cover(5)}, before) == ("the map of a was made anew",)
    both = {**before, "b": cover(1, corrections=4)}
    assert changed(both, before) == ("the map of b is in it",)
    assert changed(before, both) == ("the map of b is not in it any more",)


def test_a_correction_is_told_with_the_map_that_shows_it_also_after_a_composition_that_failed() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"a": "e1"})))
    state.handle(MapNoticed(map_notice("a", "e1", 1)))
    sketch = next(step for step in state.handle(Tick()) if isinstance(step, FetchSketch))
    state.handle(SketchFetched(sketch))
    state.handle(Solved(transforms(1, world(a="a"))))

    def composed(version: int, times: int) -> Compose:
        covers = {"a": cover(version, corrections=times, corrected_m=0.5)}
        state.handle(EdgeMapNoticed(edge_notice("e1", version, 1, covers)))
        fetch = next(step for step in state.handle(Tick()) if isinstance(step, FetchPart))
        came = state.handle(PartFetched(fetch, version, 1, covers, final=False))
        return next(step for step in came if isinstance(step, Compose))

    assert composed(1, times=1).changes == ("the map of a is in it",)
    state.handle(Composed(well=True))
    told = ("SLAM corrected the map of a by up to 0.500 m",)
    assert composed(2, times=2).changes == told
    state.handle(Composed(well=False))
    (again,) = state.handle(Tick())
    assert isinstance(again, Compose)
    assert again.changes == told
    state.handle(Composed(well=True))
    assert composed(3, times=2).changes == ()


def test_an_un_merge_is_named_also_when_the_final_world_brings_it() -> None:
    told = reason(APART, MERGED, was_final=False, final=True)
    assert told.startswith("final")
    assert "un-merged: b and c from a" in told


def test_a_merge_or_a_robot_that_leaves_is_no_un_merge() -> None:
    assert parted(MERGED, APART) == []
    assert parted(world(a="a", b="a"), MERGED) == []
    assert parted(world(b="b", c="b"), MERGED) == []


def test_un_merges_are_counted_and_the_map_composed_anew() -> None:
    state = CloudState()
    state.handle(Routed(routes(1, {"a": "e1", "b": "e2", "c": "e3"})))
    state.handle(Solved(transforms(1, MERGED)))
    assert state.counters["un-merges"] == 0
    state.handle(MapNoticed(map_notice("a", "e1", 2)))
    (fetch,) = state.handle(Tick())
    state.handle(SketchFetched(fetch))
    (solve,) = state.handle(Tick())
    assert isinstance(solve, Solve)
    assert solve.previous == transforms(1, MERGED)
    state.handle(Solved(transforms(2, APART)))
    assert state.counters["un-merges"] == 1
    assert state.world == transforms(2, APART)
