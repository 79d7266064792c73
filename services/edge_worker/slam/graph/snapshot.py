"""A `graph` kernel as bytes and back: msgpack of [header, body], the body zstd of msgpack with tagged arrays.

What can be computed again (normals, walls, local map, submaps laid out, the robot map) is not in it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import zstandard

from common.errors import SnapshotRefused
from common.geometry.pose_graph import PoseGraph
from common.wire.arrays import EXT_ARRAY, pack_array, unpack_array
from services.edge_worker.slam.graph.keyframe import Keyframe, View, normals
from services.edge_worker.slam.graph.loop import Loop
from services.edge_worker.slam.graph.loop_closer import LoopCloser
from services.edge_worker.slam.graph.settings import GraphSettings
from services.edge_worker.slam.graph.submap import Submap
from services.edge_worker.slam.graph.tracker import Tracker
from services.edge_worker.slam.graph.trajectory import Trajectory
from services.edge_worker.slam.surfaces import walls

if TYPE_CHECKING:
    from services.edge_worker.slam.graph.graph_slam import GraphSlam

KERNEL = "graph"
VERSION = 8
MOST_BYTES = 1 << 30
"""of an unpacked body"""


def write(kernel: GraphSlam) -> bytes:
    """The kernel's whole state."""
    graph, closer = kernel.graph, kernel.closer
    state = {
        "reader": kernel.reader.state(),
        "pose": kernel.pose,
        "slack": kernel.slack,
        "pending": kernel.pending,
        "first": kernel.tracker.first,
        "version": kernel.rendering.grid.version,
        "graph": [graph.poses, graph.pairs, graph.measured, graph.information, graph.loops],
        "track": kernel.track.state(),
        "keyframes": _keyframes_out(kernel.keyframes),
        "views": _views_out([*(frame.views[:-1] for frame in kernel.keyframes), kernel.views]),
        "submaps": [[s.anchor, list(s.members), s.poses] for s in closer.submaps],
        "tried": closer.tried,
        "waiting": [[w.anchor, w.keyframe, w.latest, w.measured, w.information, *w.correction] for w in closer.waiting],
        "travelled": closer.travelled,
        "torn": closer.torn,
    }
    body = zstandard.ZstdCompressor(level=1).compress(msgpack.packb(state, default=_array_out))
    header = {
        "kernel": KERNEL,
        "version": VERSION,
        "settings": settings_hash(kernel.settings),
        "sha256": hashlib.sha256(body).hexdigest(),
    }
    return bytes(msgpack.packb([header, body]))


def read(data: bytes, kernel: GraphSlam) -> None:
    """Put the state in `data` into the kernel. Raises SnapshotRefused, and then leaves the kernel as it was."""
    body = _checked(data, kernel.settings)
    try:
        plain = zstandard.ZstdDecompressor().decompress(body, max_output_size=MOST_BYTES)
        state = msgpack.unpackb(plain, ext_hook=_array_in, strict_map_key=False)
        graph, closer = PoseGraph(), LoopCloser(kernel.settings)
        graph.poses, graph.pairs, graph.measured, graph.information, graph.loops = state["graph"]
        *views, pending_views = _views_in(*state["views"])
        keyframes = _keyframes_in(views, *state["keyframes"])
        if len(keyframes) != len(graph.poses):
            raise ValueError(f"{len(keyframes)} keyframes, {len(graph.poses)} poses")
        closer.submaps = [Submap(anchor, tuple(members), poses) for anchor, members, poses in state["submaps"]]
        closer.tried, closer.travelled, closer.torn = state["tried"], state["travelled"], state["torn"]
        closer.waiting = [Loop(a, k, n, z, i, (m, r)) for a, k, n, z, i, m, r in state["waiting"]]
        tracker, track = Tracker(kernel.settings), Trajectory.of(state["track"])
        tracker.first = state["first"]
        tracker.rebuild(keyframes, graph.poses)
        pose, slack, pending = state["pose"], state["slack"], state["pending"]
        version, reader = state["version"], state["reader"]
    except (KeyError, TypeError, ValueError, IndexError, zstandard.ZstdError) as error:
        raise SnapshotRefused(f"graph: the snapshot does not hold what this program needs: {error!r}") from error
    kernel.reader.restore(reader)
    kernel.pose, kernel.slack, kernel.pending, kernel.keyframes = pose, slack, pending, keyframes
    kernel.graph, kernel.closer, kernel.tracker, kernel.track = graph, closer, tracker, track
    kernel.views = pending_views
    kernel.rendering.restart(version)


def settings_hash(settings: GraphSettings) -> str:
    return hashlib.sha256(settings.model_dump_json().encode()).hexdigest()


def _checked(data: bytes, settings: GraphSettings) -> bytes:
    """The body of a snapshot that this kernel can take over."""
    try:
        header, body = msgpack.unpackb(data, max_bin_len=MOST_BYTES)
        name, version, made_with, checksum = (header[k] for k in ("kernel", "version", "settings", "sha256"))
        known = isinstance(body, bytes) and isinstance(version, int)
    except (ValueError, TypeError, KeyError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise SnapshotRefused("graph: these bytes are no snapshot; start from the first frame") from error
    if name != KERNEL:
        raise SnapshotRefused(f"graph: the snapshot is of kernel {name!r}; restore it with that kernel")
    if not known or hashlib.sha256(body).hexdigest() != checksum:
        raise SnapshotRefused("graph: the snapshot is corrupt; take an older one, or start from the first frame")
    if version > VERSION:
        raise SnapshotRefused(f"graph: snapshot version {version} is newer than {VERSION}; upgrade this program")
    if version < VERSION:
        raise SnapshotRefused(f"graph: snapshot version {version} is older than {VERSION}; start from the first frame")
    if made_with != settings_hash(settings):
        raise SnapshotRefused("graph: the snapshot was made with other settings; restore it with those")
    return bytes(body)


def _keyframes_out(keyframes: list[Keyframe]) -> list[Any]:
    """Sizes (k, 2), lasers (k, 2), all points, beams and silent ends in one array each."""
    sizes = np.array([[len(k.points), len(k.silent)] for k in keyframes], np.int32).reshape(-1, 2)
    lasers = np.array([k.laser for k in keyframes]).reshape(-1, 2)
    points = np.concatenate([k.points for k in keyframes] or [np.empty((0, 2), np.float32)])
    beams = np.concatenate([k.beams for k in keyframes] or [np.empty(0, np.int32)]).astype(np.uint16)
    silent = np.concatenate([k.silent for k in keyframes] or [np.empty((0, 2), np.float32)])
    return [sizes, lasers, points, beams, silent]


def _keyframes_in(
    views: list[list[View]], sizes: Any, lasers: Any, points: Any, beams: Any, silent: Any
) -> list[Keyframe]:
    out = []
    p = s = 0
    for before, (ends_n, silent_n), laser in zip(views, sizes.tolist(), lasers, strict=True):
        ends, index = points[p : p + ends_n].copy(), beams[p : p + ends_n].astype(np.int32)
        quiet = silent[s : s + silent_n].copy()
        own = View(np.zeros(3), *walls(ends, index, laser), quiet, laser)
        out.append(Keyframe(ends, normals(ends, index, laser), index, quiet, laser, (*before, own)))
        p, s = p + ends_n, s + silent_n
    if p != len(points) or s != len(silent):
        raise ValueError("points left over")
    return out


def _views_out(groups: list[Sequence[View]]) -> list[Any]:
    """How many views each group has (g,), sizes (k, 2), poses and lasers (k, 5), all ends, joins and silent ends."""
    views = [view for group in groups for view in group]
    sizes = np.array([[len(view.ends), len(view.silent)] for view in views], np.int32).reshape(-1, 2)
    places = np.array([[*view.pose, *view.laser] for view in views]).reshape(-1, 5)
    ends = np.concatenate([view.ends for view in views] or [np.empty((0, 2), np.float32)])
    joined = np.concatenate([view.joined for view in views] or [np.empty(0, np.bool_)])
    silent = np.concatenate([view.silent for view in views] or [np.empty((0, 2), np.float32)])
    return [np.array([len(group) for group in groups], np.int32), sizes, places, ends, np.packbits(joined), silent]


def _views_in(groups: Any, sizes: Any, places: Any, ends: Any, joined: Any, silent: Any) -> list[list[View]]:
    views = []
    joins = np.unpackbits(joined, count=len(ends)).astype(np.bool_)
    p = s = 0
    for (ends_n, silent_n), place in zip(sizes.tolist(), places, strict=True):
        of = slice(p, p + ends_n)
        quiet = silent[s : s + silent_n].copy()
        views.append(View(place[:3].copy(), ends[of].copy(), joins[of].copy(), quiet, place[3:].copy()))
        p, s = p + ends_n, s + silent_n
    if p != len(ends) or s != len(silent) or groups.sum() != len(views):
        raise ValueError("views left over")
    last = np.cumsum(groups).tolist()
    return [views[end - count : end] for end, count in zip(last, groups.tolist(), strict=True)]


def _array_out(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return pack_array(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no part of a snapshot")


def _array_in(code: int, data: bytes) -> Any:
    if code != EXT_ARRAY:
        raise ValueError(f"unknown extension type {code}")
    return unpack_array(data).copy()
