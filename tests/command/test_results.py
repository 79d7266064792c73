"""What a run leaves in its folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.grid import Grid
from common.wire import GlobalMapNotice, StageTimes, Trace, Transforms
from services.command.collect import GlobalMap
from services.command.results import write_results


def made(grid: Grid) -> GlobalMap:
    trace = Trace(robots={}, edges={}, cloud=StageTimes(), total_s=0.0, critical=())
    notice = GlobalMapNotice(
        version=1,
        world_epoch=1,
        final=True,
        resolution=grid.resolution,
        digest=grid.digest(),
        components=(),
        covers={},
        trace=trace,
    )
    world = Transforms(world_epoch=1, final=True, resolution=grid.resolution, robots={}, components=())
    return GlobalMap(notice, grid, world, {})


def test_a_map_that_shows_nothing_leaves_no_files_of_it_nor_of_the_one_before(tmp_path: Path) -> None:
    seen = Grid.from_dense(np.full((2, 64, 64), 1, np.uint16), (0, 0), 0.05)
    files = write_results(made(seen), tmp_path)
    assert files == ["global_map.png", "global_map.yaml", "global_map.pgm"]
    assert all((tmp_path / file).is_file() for file in files)
    assert write_results(made(Grid(0.05)), tmp_path) == []
    assert not any((tmp_path / file).exists() for file in files)
    assert (tmp_path / "transforms.json").is_file()
