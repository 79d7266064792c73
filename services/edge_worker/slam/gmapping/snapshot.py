"""A `gmapping` kernel as bytes and back: magic, format, SHA-256 of the body, body (msgpack, arrays tagged).

Larger arrays are packed one by one, bytes of equal weight side by side and then zstd: numbers next to each other differ
in their low bytes only, and no second copy of everything is ever in memory. The random numbers need no state: each
registered scan draws from a stream numbered by seed and scan (Philox). The particles' maps are not in it (patch_state).
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import zstandard

from common.errors import BadMessage, SnapshotRefused
from common.grid import Grid
from common.grid.sharpen import sharpened
from common.grid.tiles import decode_counts, encode_counts
from common.wire.arrays import DTYPES, EXT_ARRAY, pack_array, unpack_array
from services.edge_worker.slam.gmapping import patch_state
from services.edge_worker.slam.gmapping.particle_chart import ParticleChart
from services.edge_worker.slam.gmapping.particle_track import ParticleTrack
from services.edge_worker.slam.gmapping.particle_tree import Generation, ParticleTree

if TYPE_CHECKING:
    from services.edge_worker.slam.gmapping.gmapping import GMapping

MAGIC = b"RecSLAM gmapping"
FORMAT = 6
HEAD_BYTES = len(MAGIC) + 2 + hashlib.sha256().digest_size
EXT_PLANES = 2
SMALL = 512
"""bytes; smaller arrays are not compressed"""
MOST_BYTES = 1 << 30
"""of one array unpacked"""


def write(kernel: GMapping) -> bytes:
    """The kernel's whole state."""
    state = {
        "settings": kernel.settings.model_dump(),
        "seed": str(kernel.seed),
        "reader": kernel.reader.state(),
        "settled": patch_state.state(kernel.settled),
        "corner": kernel.maps.corner,
        "shape": list(kernel.maps.table.shape[1:]),
        "tree": _tree_out(kernel.tree),
        "chart": _chart_out(kernel.chart),
        "track": kernel.track.state(),
        "log_weights": kernel.log_weights,
        "evidence": kernel.evidence,
        "since": kernel.since,
        "way": kernel.way,
        "spread": kernel.spread,
    }
    body = msgpack.packb(state, default=_array_out)
    return MAGIC + FORMAT.to_bytes(2, "little") + hashlib.sha256(body).digest() + body


def read(data: bytes, kernel: GMapping) -> None:
    """Put the state in `data` into the kernel. Raises SnapshotRefused, and then leaves the kernel as it was."""
    body = _checked(data)
    try:
        state = msgpack.unpackb(body, ext_hook=_array_in, strict_map_key=False)
        if state["settings"] != kernel.settings.model_dump():
            raise SnapshotRefused(f"gmapping: the snapshot was made with other settings: {_differing(state, kernel)}")
        tree, track = _tree_in(state["tree"]), ParticleTrack.of(state["track"])
        chart = _chart_in(state["chart"], kernel.settings.resolution_m)
        settled, copy = (patch_state.restored(state["settled"], kernel.settings.resolution_m) for _ in range(2))
        maps = patch_state.replayed(copy, tree.branches, state["corner"], state["shape"], kernel.settings.particles)
        arrays = {name: state[name].copy() for name in ("log_weights", "evidence", "since", "spread")}
        seed, way, reader = int(state["seed"]), float(state["way"]), state["reader"]
    except (LookupError, TypeError, ValueError, AttributeError, zstandard.ZstdError, BadMessage) as error:
        raise SnapshotRefused(f"gmapping: the snapshot does not hold what this program needs: {error!r}") from error
    kernel.reader.restore(reader)
    vars(kernel.maps).update(vars(maps))  # the matcher holds them
    kernel.settled = settled
    kernel.seed, kernel.way = seed, way
    kernel.tree, kernel.track = tree, track
    vars(kernel.chart.grid).update(vars(chart.grid))  # whoever holds the grid keeps holding it
    kernel.chart.canvas, kernel.chart.drawn, kernel.chart.followed = chart.canvas, chart.drawn, chart.followed
    vars(kernel).update(arrays)


def _checked(data: bytes) -> bytes:
    if data[: len(MAGIC)] != MAGIC:
        raise SnapshotRefused("gmapping: this is no snapshot of a gmapping kernel; restore it with the kernel it is of")
    version = int.from_bytes(data[len(MAGIC) : len(MAGIC) + 2], "little")
    if version > FORMAT:
        raise SnapshotRefused(f"gmapping: snapshot format {version} is newer than {FORMAT}; upgrade this program")
    if 0 < version < FORMAT:
        raise SnapshotRefused(f"gmapping: snapshot format {version} is older than {FORMAT}; start from the first frame")
    body = data[HEAD_BYTES:]
    if hashlib.sha256(body).digest() != data[len(MAGIC) + 2 : HEAD_BYTES] or version != FORMAT:
        raise SnapshotRefused("gmapping: the snapshot is corrupt; take an older one, or start from the first frame")
    return body


def _differing(state: dict[str, Any], kernel: GMapping) -> str:
    ours = kernel.settings.model_dump()
    names = sorted(set(ours) | set(state["settings"]))
    return ", ".join(name for name in names if ours.get(name) != state["settings"].get(name))


def _tree_out(tree: ParticleTree) -> dict[str, Any]:
    branches = tree.branches
    return {
        "settled": np.array(tree.settled).reshape(-1, 3),
        "sizes": np.array([[len(g.poses), len(g.points), len(g.silent)] for g in branches], np.int32),
        "poses": np.concatenate([g.poses for g in branches]),
        "parents": np.concatenate([g.parents for g in branches]).astype(np.uint16),
        "points": np.concatenate([g.points for g in branches]),
        "silent": np.concatenate([g.silent for g in branches]),
        "lasers": np.array([g.laser for g in branches]),
    }


def _tree_in(state: dict[str, Any]) -> ParticleTree:
    tree = ParticleTree()
    tree.settled = [pose.copy() for pose in state["settled"]]
    ends = np.cumsum(state["sizes"], axis=0, dtype=np.int64)
    parts = [
        [part.copy() for part in np.split(state[name], ends[:-1, column])]
        for name, column in (("poses", 0), ("parents", 0), ("points", 1), ("silent", 2))
    ]
    tree.branches = deque(
        Generation(poses, parents.astype(np.int64), points, silent, laser.copy())
        for poses, parents, points, silent, laser in zip(*parts, state["lasers"], strict=True)
    )
    return tree


def _chart_out(chart: ParticleChart) -> dict[str, Any]:
    grid, canvas = chart.grid, chart.canvas
    return {
        "version": grid.version,
        "changed": [[*key, version] for key, version in grid.changed.items()],
        "canvas": [[*key, encode_counts(tile)] for key, tile in canvas.tiles.items()],
        "touched": sorted(canvas.touched),
        "published": [[*key, encode_counts(grid.tiles[key])] for key in sorted(canvas.stale()) if key in grid.tiles],
        "drawn": np.array(chart.drawn).reshape(-1, 3),
    }


def _chart_in(state: dict[str, Any], resolution_m: float) -> ParticleChart:
    chart = ParticleChart(resolution_m)
    canvas = chart.canvas
    canvas.tiles = {(x, y): decode_counts(data).copy() for x, y, data in state["canvas"]}
    canvas.touched = {(x, y) for x, y in state["touched"]}
    changed = {(x, y): version for x, y, version in state["changed"]}
    tiles = {key: sharpened(canvas.tiles, key) for key in changed}
    tiles.update({(x, y): decode_counts(data).copy() for x, y, data in state["published"]})
    chart.grid = Grid(resolution_m, tiles, state["version"], changed)
    chart.drawn = list(state["drawn"].copy())
    return chart


def _array_out(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__} does not go into a snapshot")
    if value.nbytes < SMALL:
        return pack_array(value)
    code = value.dtype.str[1:]
    if code not in DTYPES:
        raise TypeError(f"arrays of {value.dtype} do not go into a snapshot")
    planes = np.ascontiguousarray(np.ascontiguousarray(value).reshape(-1, 1).view(np.uint8).T).reshape(-1)
    packed = zstandard.ZstdCompressor(level=1).compress(planes.data)
    return msgpack.ExtType(EXT_PLANES, msgpack.packb([code, list(value.shape), packed]))


def _array_in(code: int, data: bytes) -> np.ndarray:
    if code == EXT_ARRAY:
        return unpack_array(data).copy()
    if code != EXT_PLANES:
        raise ValueError(f"unknown extension type {code}")
    kind, shape, packed = msgpack.unpackb(data)
    dtype = np.dtype("<" + kind)
    size = math.prod(shape) * dtype.itemsize
    if kind not in DTYPES or not 0 <= size <= MOST_BYTES or zstandard.frame_content_size(packed) != size:
        raise ValueError(f"an array of {kind} {shape} is not what is packed")
    planes = np.frombuffer(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size), np.uint8)
    # a copy: compiled code takes arrays that cannot be written for another type, and would be compiled once more
    return planes.reshape(dtype.itemsize, -1).T.copy().view(dtype).reshape(shape)
