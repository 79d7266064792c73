"""The relation error of Kümmerle et al. 2009 (Autonomous Robots 27:387): relative poses against surveyed ones.

A relation says where the robot stood at `t2`, seen from where it stood at `t1`. It needs no common frame, so a
map of several robots is judged by relations whose two ends belong to different robots. Two readings are kept apart:

* all: every relation. Where no pose was estimated at a stamp, the estimates before and after it are both carried
  there by raw odometry and blended by time. A relation's end belongs to the track that covers its stamp best.
* exact: only relations with an estimate within `EXACT_S` of both ends, where odometry says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import BadFile, UsageError
from common.formats.text import numbered_lines
from common.geometry import between, compose, wrap

EXACT_S = 0.006
MAX_OUTSIDE_S = 5.0
"""An end further than this outside every track is not scored."""


class RelationStats(NamedTuple):
    """Mean and standard deviation over `n` relations: metres and degrees, NaN for none."""

    n: int
    translation: float
    translation_sd: float
    translation_median: float
    translation_max: float
    rotation: float
    rotation_sd: float


@dataclass(frozen=True)
class RelationScore:
    """Errors of the scored relations, row by row."""

    translation: NDArray[np.float64]
    """(n,) m"""
    rotation: NDArray[np.float64]
    """(n,) degrees"""
    exact: NDArray[np.bool_]
    """(n,) both ends lie at estimates"""
    across: NDArray[np.bool_]
    """(n,) the ends belong to different tracks"""
    unscored: int
    """relations with an end outside every track; a map that leaves any fails"""

    def stats(self, *, exact: bool = False, across: bool | None = None) -> RelationStats:
        """Of all relations or the exact ones; within one track (False), across two (True), or both (None)."""
        chosen = self.exact if exact else np.ones(len(self.exact), bool)
        if across is not None:
            chosen = chosen & (self.across == across)
        if not chosen.any():
            return RelationStats(0, *[float("nan")] * 6)
        shift, turn = np.sort(self.translation[chosen]), self.rotation[chosen]
        middle = shift[len(shift) // 2]
        return RelationStats(
            len(shift), *map(float, (shift.mean(), shift.std(), middle, shift[-1], turn.mean(), turn.std()))
        )


def read_relations(path: str | Path) -> NDArray[np.float64]:
    """(n, 5): t1 s, t2 s, and the pose at t2 seen from t1 (m, m, rad), of rows `t1 t2 x y z roll pitch yaw`."""
    rows = []
    for number, line in numbered_lines(path):
        try:
            values = [float(field) for field in line.split()[:8]]
        except ValueError as error:
            raise BadFile(f"{path}:{number}: {error}") from error
        if len(values) == 8:
            rows.append([*values[:4], values[7]])
    if not rows:
        raise BadFile(f"{path}: holds no rows `t1 t2 x y z roll pitch yaw`")
    return np.array(rows)


def read_odometry(path: str | Path) -> NDArray[np.float64]:
    """(n, 4): stamp, x, y, theta of every ODOM and FLASER row of a CARMEN log, by stamp; none is left out."""
    rows = []
    for number, line in numbered_lines(path):
        kind, *fields = line.split()
        try:
            if kind == "ODOM":
                rows.append([float(fields[6]), *map(float, fields[:3])])
            elif kind == "FLASER":
                tail = fields[1 + int(fields[0]) :]
                rows.append([float(tail[6]), *map(float, tail[3:6])])
        except (ValueError, IndexError) as error:
            raise BadFile(f"{path}:{number}: {error}") from error
    return _by_time(rows, f"odometry of {path}")


def score_relations(
    relations: ArrayLike, odometry: ArrayLike, tracks: Sequence[ArrayLike], exact_s: float = EXACT_S
) -> RelationScore:
    """Score tracks (each (n, 4): stamp, x, y, theta; all in one frame) on relations (m, 5) as read above.

    `odometry` (k, 4) is the raw odometry on the same clock. Raises UsageError for a track of fewer than two rows.
    """
    relations = np.asarray(relations, np.float64).reshape(-1, 5)
    odom = _by_time(odometry, "odometry")
    placed = [_by_time(track, f"track {i}") for i, track in enumerate(tracks)]
    if not placed:
        raise UsageError("there is no track to score")
    ends = [_locate(relations[:, side], placed, odom) for side in (0, 1)]
    (first, first_owner, first_outside, first_off), (second, second_owner, second_outside, second_off) = ends
    scored = np.maximum(first_outside, second_outside) <= MAX_OUTSIDE_S
    moved = between(first, second)[scored]
    said = relations[scored, 2:]
    return RelationScore(
        np.hypot(moved[:, 0] - said[:, 0], moved[:, 1] - said[:, 1]),
        np.degrees(np.abs(wrap(moved[:, 2] - said[:, 2]))),
        (np.maximum(first_off, second_off) <= exact_s)[scored],
        (first_owner != second_owner)[scored],
        int((~scored).sum()),
    )


def _locate(
    t: NDArray[np.float64], tracks: list[NDArray[np.float64]], odom: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Of the times `t` (m,): poses (m, 3), the owning tracks, seconds outside them, seconds to their nearest row."""
    outside = np.array([np.maximum(np.maximum(k[0, 0] - t, t - k[-1, 0]), 0) for k in tracks])
    owner = outside.argmin(axis=0)
    poses, off = np.empty((len(t), 3)), np.empty(len(t))
    for index, track in enumerate(tracks):
        mine = owner == index
        before, after, share = _bracket(track[:, 0], t[mine])
        here = _at(odom, t[mine])
        carried = [compose(track[k, 1:], between(_at(odom, track[k, 0]), here)) for k in (before, after)]
        poses[mine] = _blend(carried[0], carried[1], share)
        off[mine] = np.minimum(np.abs(t[mine] - track[before, 0]), np.abs(t[mine] - track[after, 0]))
    return poses, owner, outside.min(axis=0), off


def _bracket(
    stamps: NDArray[np.float64], t: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Rows before and after each `t`, and how far it lies between them (0..1)."""
    after = np.clip(np.searchsorted(stamps, t, side="right"), 1, len(stamps) - 1)
    start, end = stamps[after - 1], stamps[after]
    apart = end > start
    share = np.where(apart, (t - start) / np.where(apart, end - start, 1.0), 0.0)
    return after - 1, after, np.clip(share, 0.0, 1.0)


def _at(track: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (m, 3) of a track at the times `t` (m,)."""
    before, after, share = _bracket(track[:, 0], t)
    return _blend(track[before, 1:], track[after, 1:], share)


def _blend(a: NDArray[np.float64], b: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """From poses a towards poses b by `share` of the motion between them, seen from a."""
    return compose(a, between(a, b) * share[:, None])


def _by_time(rows: ArrayLike, what: str) -> NDArray[np.float64]:
    table = np.asarray(rows, np.float64).reshape(-1, 4)
    if len(table) < 2:
        raise UsageError(f"{what} has {len(table)} rows; at least two are needed to tell a pose between them")
    # Rows of one stamp (logs repeat poses) are ordered by their poses: then the order of the input cannot matter.
    return table[np.lexsort(table.T[::-1])]
