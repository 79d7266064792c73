"""However robots are grouped, and in whatever order their maps come, the final global map is the same, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_worlds import apartment, seen
from test_bend import drifted

from common.fusion.pairs import all_pairs
from common.geometry import between
from common.grid import Grid
from common.grid.raster import Raster
from common.grid.tiles import encode_counts, encode_occupancy
from common.wire import Transforms, Verdicts, decode, encode
from services.cloud_merger.merge_host import MergeHost
from services.edge_worker.fusion_host import FusionHost

PAGE = 1 << 24
Tracks = dict[str, bytes]
WINDOWS = {"ant": (0.0, 8.0), "bee": (5.0, 13.0), "cat": (9.0, 16.0), "dog": (0.0, 16.0)}
FRAMES = {"ant": (3, 2, 0.3), "bee": (-4, 7, 2.0), "cat": (1, 1, -1.0), "dog": (8, -2, 3.0)}


@pytest.fixture(scope="module")
def grids() -> dict[str, Grid]:
    world = apartment(5)
    return {name: seen(world, FRAMES[name], WINDOWS[name], seed=k) for k, name in enumerate(WINDOWS)}


def final_map(grids: dict[str, Grid], groups: list[list[str]], tracks: Tracks | None = None) -> tuple[str, Transforms]:
    """Digest and transforms of the final map, made by one edge a group and the cloud; jointly corrected by `tracks`."""
    cloud, edges = MergeHost(), [FusionHost() for _ in groups]
    by_edges = []
    for edge, group in zip(edges, groups, strict=True):
        for name in group:
            tiles = [(x, y, encode_counts(counts)) for (x, y), counts in grids[name].tiles.items()]
            edge.put(name, 0.05, 1, True, {"stream": "0" * 32, "seq": 9, "epoch": (1, 1)}, tiles, True)
        told = decode(edge.fuse("edge", group, None)["verdicts"])
        assert isinstance(told, Verdicts)
        by_edges += told.pairs
    for name in (name for group in groups for name in group):
        raster = Raster(0.05)
        raster.follow(grids[name])
        cloud.put_sketch(name, 0.05, 1, True, [(x, y, encode_occupancy(c)) for (x, y), c in raster.tiles.items()])
    solved = cloud.solve(
        sorted(grids), all_pairs(grids), encode(Verdicts(owner="edges", pairs=tuple(by_edges))), True, None, 0, {}
    )
    if tracks is not None:
        solved |= cloud.correct(solved["transforms"], solved["merged"], {n: tracks[n] for g in groups for n in g})
    for k, (edge, group) in enumerate(zip(edges, groups, strict=True)):
        edge.fuse("edge", group, solved["transforms"])
        page = edge.tiles(0, "", PAGE)
        cloud.put_part(f"edge-{k}", 0.05, page["version"], [(x, y, data) for x, y, _, data in page["tiles"]], True)
    versions = {f"edge-{k}": cloud._parts[f"edge-{k}"][0] for k in range(len(groups))}
    transforms = decode(solved["transforms"])
    assert isinstance(transforms, Transforms)
    return cloud.compose(versions)["digest"], transforms


@pytest.mark.parametrize(
    "groups",
    [
        [["ant", "bee"], ["cat", "dog"]],
        [["dog", "bee"], ["ant"], ["cat"]],
        [["dog"], ["cat"], ["bee"], ["ant"]],
    ],
)
def test_every_grouping_gives_the_same_final_map(grids: dict[str, Grid], groups: list[list[str]]) -> None:
    digest, transforms = final_map(grids, [sorted(grids)])
    again, others = final_map(grids, groups)
    assert (digest, transforms.robots) == (again, others.robots)
    assert [each.robots for each in transforms.components] == [("ant", "bee", "cat", "dog")]
    assert np.isfinite([placed.transform.pose() for placed in transforms.robots.values()]).all()


def test_any_grouping_gives_the_same_corrected_map(grids: dict[str, Grid]) -> None:
    bent = {**grids, "dog": seen(drifted(apartment(5), 0.006, straight_m=4.0), FRAMES["dog"], WINDOWS["dog"], seed=3)}
    tracks = {}
    for name, (low, high) in WINDOWS.items():
        x = np.linspace(low + 1.0, high - 1.0, 60)
        poses = between(FRAMES[name], np.stack([x, np.full(60, 5.0), np.zeros(60)], axis=1))
        tracks[name] = np.column_stack([x, poses]).tobytes()
    digest, transforms = final_map(bent, [sorted(bent)], tracks)
    assert "corrected" in transforms.reason
    assert any(placed.warp is not None for placed in transforms.robots.values())
    again, others = final_map(bent, [["dog"], ["cat", "ant"], ["bee"]], tracks)
    assert (digest, transforms.robots) == (again, others.robots)
