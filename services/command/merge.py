"""Merging saved maps: map_server maps of any origin and resolution, from any SLAM, into one map per component."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile, UsageError
from common.formats.map_server import SavedMap, read_map, write_map
from common.formats.picture import write_png
from common.fusion.layout import bounds, lay_out
from common.fusion.matchmap import MatchMap
from common.fusion.overlap import Footprints
from common.fusion.pairs import PairTable, all_pairs
from common.fusion.solve import Solved, solve
from common.fusion.verdicts import measurements
from common.geometry import compose, inverse
from common.geometry.se2 import Pose
from common.grid import Grid
from common.grid.compose import compose_into
from common.grid.render import render
from common.wire.edge import PairVerdict

MOST_CELLS = 200_000_000
"""of a saved map drawn at the finest resolution: half a square kilometre at 5 cm"""
VOTES = 100
"""visits that a known cell of a saved map counts for: such maps tell no counts, so each has one equal vote"""


@dataclass(frozen=True)
class Piece:
    """A saved map in the frame of its image: cell [0, 0] at the origin, axes along rows and columns."""

    path: Path
    saved: SavedMap
    grid: Grid
    map: MatchMap
    """at the resolution that all are compared at"""


@dataclass(frozen=True)
class Merged:
    """What became of some saved maps; names are unique and tell the files."""

    pieces: dict[str, Piece]
    verdicts: tuple[PairVerdict, ...]
    """transforms are between image frames"""
    components: list[Solved]
    poses: dict[str, Pose]
    """pose of each map's own frame (that of its yaml) in the merged map's"""

    def grid(self, names: Sequence[str]) -> Grid:
        """The sum of these maps, each rendered once, at the finest of their resolutions."""
        resolution = min(self.pieces[name].grid.resolution for name in names)
        product = Grid(resolution)
        parts = [render(self.pieces[name].grid, self.image_pose(name), resolution) for name in names]
        compose_into(product, parts, sharpen=True)
        return product

    def image_pose(self, name: str) -> Pose:
        """Pose of the map's image frame in the merged map's."""
        return compose(self.poses[name], self.pieces[name].saved.origin)

    def overlap(self) -> NDArray[np.float64]:
        """(n, n) overlapping degrees w, 0 to 0.5, by sorted names; 0 between components."""
        names = sorted(self.pieces)
        maps, poses = [self.pieces[name].map for name in names], [self.image_pose(name) for name in names]
        part = np.array([next(each.id for each in self.components if name in each.robots) for name in names])
        weights = Footprints.of(maps, poses).weights()
        weights[part[:, None] != part[None, :]] = 0.0
        return weights


def merge(paths: Sequence[Path]) -> Merged:
    """Merge the maps whose yaml files are `paths`.

    The merged frame is that of the first map (by name) of the first component. Raises BadFile and UsageError.
    """
    if len(paths) < 2:
        raise UsageError("a merge takes two maps at least: name their yaml files")
    pieces = _pieces(paths)
    table = PairTable()
    for name, piece in pieces.items():
        table.put(name, piece.map, 0, True)
    table.decide(all_pairs(pieces))
    solved = solve(sorted(pieces), measurements(table.verdicts.values()))
    own = {
        name: compose(compose(pieces[each.id].saved.origin, each.transforms[name]), inverse(pieces[name].saved.origin))
        for each in solved
        for name in each.robots
    }
    boxes = {
        each.id: bounds((pieces[name].map, compose(own[name], pieces[name].saved.origin)) for name in each.robots)
        for each in solved
    }
    places = lay_out(boxes)
    poses = {name: compose(places[each.id], own[name]) for each in solved for name in each.robots}
    return Merged(pieces, tuple(table.verdicts[pair] for pair in sorted(table.verdicts)), solved, poses)


def write(merged: Merged, folder: Path) -> list[Path]:
    """Write merged.yaml with its images, one map per component where there are several, and merge.json."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [_write_grid(folder / "merged", merged.grid(sorted(merged.pieces)))]
    if len(merged.components) > 1:
        for each in merged.components:
            written.append(_write_grid(folder / f"component-{each.id}", merged.grid(each.robots)))
    (folder / "merge.json").write_text(json.dumps(as_data(merged), indent=2) + "\n")
    return [*written, folder / "merge.json"]


def as_data(merged: Merged) -> dict[str, Any]:
    """For programs."""
    return {
        "maps": {name: str(piece.path) for name, piece in merged.pieces.items()},
        "resolution": min(piece.grid.resolution for piece in merged.pieces.values()),
        "components": [
            {
                "id": each.id,
                "maps": list(each.robots),
                "left_out": [[*pair, why] for pair, why in each.left_out.items()],
            }
            for each in merged.components
        ],
        "transforms": {name: [float(v) for v in merged.poses[name]] for name in sorted(merged.poses)},
        "verdicts": [
            each.model_dump(mode="json", exclude={"versions", "final", "information", "transform"})
            for each in merged.verdicts
        ],
    }


def as_lines(merged: Merged) -> list[str]:
    """For people."""
    lines = [f"{each.a} - {each.b}: {each.kind}; {each.reason}" for each in merged.verdicts]
    for each in merged.components:
        lines += [f"{a} - {b}: left out; {why}" for (a, b), why in each.left_out.items()]
    for name, (x, y, theta) in sorted(merged.poses.items()):
        lines.append(f"{name}: at {x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f} degrees")
    parts = [", ".join(each.robots) for each in merged.components]
    if len(parts) == 1:
        return [*lines, f"one map of {parts[0]}"]
    return [*lines, f"{len(parts)} maps that are not known to share anything, laid out apart: {' | '.join(parts)}"]


def overlap_data(merged: Merged) -> dict[str, Any]:
    """For programs."""
    return {"maps": sorted(merged.pieces), "weights": merged.overlap().tolist()}


def overlap_lines(merged: Merged) -> list[str]:
    """The overlap matrix as a table."""
    names = sorted(merged.pieces)
    width = max(8, *(len(name) for name in names))
    rows = [
        " ".join([f"{name:{width}}", *(f"{w:{width}.3f}" for w in row)])
        for name, row in zip(names, merged.overlap(), strict=True)
    ]
    return [" ".join([" " * width, *(f"{name:>{width}}" for name in names)]), *rows]


def _pieces(paths: Sequence[Path]) -> dict[str, Piece]:
    saved = {name: (path, read_map(path)) for name, path in zip(_names(paths), paths, strict=True)}
    _check_sizes(saved)
    coarsest = max(each.resolution for _, each in saved.values())
    pieces = {}
    for name, (path, each) in sorted(saved.items()):
        grid = _votes(each)
        compared = grid if grid.resolution == coarsest else render(grid, np.zeros(3), coarsest)
        pieces[name] = Piece(path, each, grid, MatchMap.from_grid(compared))
    return pieces


def _check_sizes(saved: dict[str, tuple[Path, SavedMap]]) -> None:
    """Raises BadFile for a map that is far too large to be drawn at the resolution of the finest one."""
    finest = min(each.resolution for _, each in saved.values())
    for path, each in saved.values():
        height, width = (count * each.resolution for count in each.occupancy.shape)
        if height / finest * (width / finest) > MOST_CELLS:
            raise BadFile(
                f"{path}: resolution {each.resolution:g} makes it {width:.0f} x {height:.0f} m, too much to be drawn "
                f"at {finest:g} m a cell; is it in metres?"
            )


def _names(paths: Sequence[Path]) -> list[str]:
    """The files' stems; those that occur more than once with their folder's name, or counted."""
    stems = [path.stem for path in paths]
    longer = [
        f"{path.absolute().parent.name}-{stem}" if stems.count(stem) > 1 else stem
        for path, stem in zip(paths, stems, strict=True)
    ]
    seen: Counter[str] = Counter()
    names = []
    for name in longer:
        seen[name] += 1
        names.append(name if longer.count(name) == 1 else f"{name}-{seen[name]}")
    return names


def _votes(saved: SavedMap) -> Grid:
    """Counts whose ratio is the map's occupancy."""
    counts = np.zeros((2, *saved.occupancy.shape), np.uint16)
    known = saved.occupancy >= 0
    counts[0][known] = saved.occupancy[known]
    counts[1][known] = VOTES
    return Grid.from_dense(counts, (0, 0), saved.resolution)


def _write_grid(path: Path, grid: Grid) -> Path:
    cells, (x, y) = grid.occupancy()
    origin = (x * grid.resolution, y * grid.resolution, 0.0)
    write_png(path.with_name(f"{path.name}.png"), cells, grid.resolution, origin)
    return write_map(path, cells, grid.resolution, origin)
