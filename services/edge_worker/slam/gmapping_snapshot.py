"""A `gmapping` kernel as bytes and back: magic, format, SHA-256 of the body, body (zstd of msgpack, arrays tagged).

The random numbers need no state: each registered scan draws from a stream numbered by seed and scan (Philox).
"""

from __future__ import annotations

import hashlib
from collections import deque
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import zstandard

from common.errors import BadMessage, SnapshotRefused
from common.grid import Grid
from common.grid.tiles import decode_counts, encode_counts
from common.wire.arrays import EXT_ARRAY, pack_array, unpack_array
from services.edge_worker.slam.particle_chart import ParticleChart
from services.edge_worker.slam.particle_track import ParticleTrack
from services.edge_worker.slam.particle_tree import Generation, ParticleTree

if TYPE_CHECKING:
    from services.edge_worker.slam.gmapping import GMapping

MAGIC = b"RecSLAM gmapping"
FORMAT = 2
HEAD_BYTES = len(MAGIC) + 2 + hashlib.sha256().digest_size
MOST_BYTES = 1 << 31
"""of a body unpacked"""


def write(kernel: GMapping) -> bytes:
    """The kernel's whole state."""
    state = {
        "settings": kernel.settings.model_dump(),
        "seed": str(kernel.seed),
        "reader": kernel.reader.state(),
        "maps": _maps_out(kernel.maps.state()),
        "tree": _tree_out(kernel.tree),
        "chart": _chart_out(kernel.chart),
        "track": kernel.track.state(),
        "log_weights": kernel.log_weights,
        "evidence": kernel.evidence,
        "since": kernel.since,
        "way": kernel.way,
        "spread": kernel.spread,
    }
    body = zstandard.ZstdCompressor(level=1).compress(msgpack.packb(state, default=_array_out))
    return MAGIC + FORMAT.to_bytes(2, "little") + hashlib.sha256(body).digest() + body


def read(data: bytes, kernel: GMapping) -> None:
    """Put the state in `data` into the kernel. Raises SnapshotRefused, and then leaves the kernel as it was."""
    body = _checked(data)
    try:
        state = msgpack.unpackb(
            zstandard.ZstdDecompressor().decompress(body, max_output_size=MOST_BYTES),
            ext_hook=_array_in,
            strict_map_key=False,
        )
        if state["settings"] != kernel.settings.model_dump():
            raise SnapshotRefused(f"gmapping: the snapshot was made with other settings: {_differing(state, kernel)}")
        maps, seed = _maps_in(state["maps"], kernel.settings.particles), int(state["seed"])
        tree, track = _tree_in(state["tree"]), ParticleTrack.of(state["track"])
        chart = _chart_in(state["chart"], kernel.settings.resolution_m)
        arrays = {name: state[name].copy() for name in ("log_weights", "evidence", "since", "spread")}
        way, reader = float(state["way"]), state["reader"]
    except (KeyError, TypeError, ValueError, AttributeError, zstandard.ZstdError, BadMessage) as error:
        raise SnapshotRefused(f"gmapping: the snapshot does not hold what this program needs: {error!r}") from error
    kernel.reader.restore(reader)
    kernel.maps.restore(maps)
    kernel.seed, kernel.way = seed, way
    kernel.tree, kernel.track = tree, track
    vars(kernel.chart.grid).update(vars(chart.grid))  # whoever holds the grid keeps holding it
    kernel.chart.canvas, kernel.chart.drawn = chart.canvas, chart.drawn
    vars(kernel).update(arrays)


def _checked(data: bytes) -> bytes:
    if data[: len(MAGIC)] != MAGIC:
        raise SnapshotRefused("gmapping: this is no snapshot of a gmapping kernel; restore it with the kernel it is of")
    version = int.from_bytes(data[len(MAGIC) : len(MAGIC) + 2], "little")
    if version > FORMAT:
        raise SnapshotRefused(f"gmapping: snapshot format {version} is newer than {FORMAT}; upgrade this program")
    body = data[HEAD_BYTES:]
    if version < FORMAT or hashlib.sha256(body).digest() != data[len(MAGIC) + 2 : HEAD_BYTES]:
        raise SnapshotRefused("gmapping: the snapshot is corrupt; take an older one, or start from the first frame")
    return body


def _differing(state: dict[str, Any], kernel: GMapping) -> str:
    ours = kernel.settings.model_dump()
    names = sorted(set(ours) | set(state["settings"]))
    return ", ".join(name for name in names if ours.get(name) != state["settings"].get(name))


def _maps_out(state: dict[str, Any]) -> dict[str, Any]:
    return {**state, "near": state["near"].view(np.uint16)}


def _maps_in(state: dict[str, Any], particles: int) -> dict[str, Any]:
    table, hits = state["table"], state["hits"]
    if len(table) != particles or (table.size and not 0 <= table.min() <= table.max() < len(hits)):
        raise ValueError("particle maps point to patches that are not there")
    return {**state, "near": state["near"].view(np.int16)}


def _tree_out(tree: ParticleTree) -> dict[str, Any]:
    branches = [[g.poses, g.parents, g.points, g.silent, g.laser] for g in tree.branches]
    return {"settled": np.array(tree.settled).reshape(-1, 3), "branches": branches}


def _tree_in(state: dict[str, Any]) -> ParticleTree:
    tree = ParticleTree()
    tree.settled = [pose.copy() for pose in state["settled"]]
    tree.branches = deque(Generation(*fields) for fields in state["branches"])
    return tree


def _chart_out(chart: ParticleChart) -> dict[str, Any]:
    grid, canvas = chart.grid, chart.canvas
    return {
        "version": grid.version,
        "changed": [[*key, version] for key, version in grid.changed.items()],
        "canvas": [[*key, encode_counts(tile)] for key, tile in canvas.tiles.items()],
        "touched": sorted(canvas.touched),
        "published": [[*key, encode_counts(grid.tiles[key])] for key in sorted(canvas.touched) if key in grid.tiles],
        "drawn": np.array(chart.drawn).reshape(-1, 3),
    }


def _chart_in(state: dict[str, Any], resolution_m: float) -> ParticleChart:
    chart = ParticleChart(resolution_m)
    canvas = chart.canvas
    canvas.tiles = {(x, y): decode_counts(data).copy() for x, y, data in state["canvas"]}
    canvas.touched = {(x, y) for x, y in state["touched"]}
    changed = {(x, y): version for x, y, version in state["changed"]}
    tiles = {key: canvas.tiles[key].copy() for key in changed}
    tiles.update({(x, y): decode_counts(data).copy() for x, y, data in state["published"]})
    chart.grid = Grid(resolution_m, tiles, state["version"], changed)
    chart.drawn = list(state["drawn"].copy())
    return chart


def _array_out(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return pack_array(value)
    raise TypeError(f"{type(value).__name__} does not go into a snapshot")


def _array_in(code: int, data: bytes) -> np.ndarray:
    if code != EXT_ARRAY:
        raise ValueError(f"unknown extension type {code}")
    return unpack_array(data)
