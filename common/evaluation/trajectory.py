"""How far an estimated trajectory lies from the truth: absolute (ATE) and relative (RPE) errors in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import UsageError
from common.geometry import between, compose, interpolate, wrap

Track = NDArray[np.float64]
"""(n, 4): stamp s, x m, y m, theta rad"""


class ErrorStats(NamedTuple):
    """Errors of `n` poses (or pairs of poses): metres, and radians of heading; NaN for none."""

    n: int
    rmse: float
    mean: float
    max: float
    rotation_rmse: float
    rotation_mean: float


def fit(points: ArrayLike, onto: ArrayLike) -> NDArray[np.float64]:
    """The pose (3,) that moves points (n, 2) onto their counterparts (n, 2) with the least squared distance.

    Umeyama 1991 in the plane, without scale: there the rotation has a closed form. One point (or none that differ)
    leaves the rotation open: it is then 0.
    """
    points, onto = np.asarray(points, np.float64).reshape(-1, 2), np.asarray(onto, np.float64).reshape(-1, 2)
    if len(points) != len(onto) or not len(points):
        raise UsageError(f"a fit needs pairs of points, got {len(points)} and {len(onto)}")
    here, there = points.mean(axis=0), onto.mean(axis=0)
    a, b = points - here, onto - there
    theta = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(theta), np.sin(theta)
    return np.array([there[0] - c * here[0] + s * here[1], there[1] - s * here[0] - c * here[1], theta])


def associate(estimate: ArrayLike, truth: ArrayLike, max_gap: float = 0.5) -> tuple[Track, Track]:
    """The rows of `estimate` that the truth covers, and the truth at their stamps; both (m, 4).

    The truth is interpolated between its two rows around a stamp, if they are no more than `max_gap` s apart; a
    stamp that a row of the truth carries needs no neighbours.
    """
    ours, theirs = _track(estimate), _track(truth)
    if not len(ours) or not len(theirs):
        return ours[:0], ours[:0]
    stamps, t = theirs[:, 0], ours[:, 0]
    after = np.clip(np.searchsorted(stamps, t), 0, len(stamps) - 1)
    before = np.where(stamps[after] == t, after, after - 1)
    start, end = stamps[before], stamps[after]
    covered = (before >= 0) & (start <= t) & (t <= end) & (end - start <= max_gap)
    poses = interpolate(stamps, theirs[:, 1:], t[covered])
    return ours[covered], np.column_stack([t[covered], poses])


def fit_all(
    estimates: Sequence[ArrayLike], truths: Sequence[ArrayLike], max_gap: float = 0.5
) -> tuple[NDArray[np.float64], list[Track], list[Track]]:
    """ONE pose (3,) for all robots that fits their estimated trajectories onto the true ones.

    Returns it with the associated rows of each robot: estimates after the fit, and truths. It is one fit because the
    robots' places relative to each other are what a merged map claims to know.
    """
    pairs = [associate(e, t, max_gap) for e, t in zip(estimates, truths, strict=True)]
    ours, theirs = (
        np.concatenate([np.empty((0, 4)), *side]) for side in ([e for e, _ in pairs], [t for _, t in pairs])
    )
    if not len(ours):
        raise UsageError("no estimated pose has a stamp that the truth covers; are both on one clock?")
    pose = fit(ours[:, 1:3], theirs[:, 1:3])
    moved = [np.column_stack([e[:, 0], compose(pose, e[:, 1:])]) for e, _ in pairs]
    return pose, moved, [t for _, t in pairs]


def absolute_error(
    estimates: Sequence[ArrayLike], truths: Sequence[ArrayLike], max_gap: float = 0.5, align: bool = True
) -> ErrorStats:
    """ATE over all robots' poses, after one common fit (or as they stand)."""
    if align:
        _, moved, reference = fit_all(estimates, truths, max_gap)
    else:
        pairs = [associate(e, t, max_gap) for e, t in zip(estimates, truths, strict=True)]
        moved, reference = [e for e, _ in pairs], [t for _, t in pairs]
    a, b = np.concatenate(moved), np.concatenate(reference)
    return _stats(np.hypot(*(a - b)[:, 1:3].T), a[:, 3] - b[:, 3])


def relative_error(estimate: ArrayLike, truth: ArrayLike, metres: float = 1.0, max_gap: float = 0.5) -> ErrorStats:
    """RPE: the drift over stretches of `metres` along the true way, from every pose that one starts at."""
    ours, theirs = associate(estimate, truth, max_gap)
    steps = np.diff(theirs[:, 1:3], axis=0, prepend=theirs[:1, 1:3])
    way = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))
    end = np.searchsorted(way, way + metres)
    start = np.flatnonzero(end < len(way))
    end = end[start]
    drift = between(between(theirs[start, 1:], theirs[end, 1:]), between(ours[start, 1:], ours[end, 1:]))
    return _stats(np.hypot(drift[:, 0], drift[:, 1]), drift[:, 2])


def _stats(distance: NDArray[np.float64], rotation: NDArray[np.float64]) -> ErrorStats:
    if not len(distance):
        return ErrorStats(0, *[float("nan")] * 5)
    turn = np.abs(wrap(rotation))
    return ErrorStats(
        len(distance),
        float(np.sqrt((distance**2).mean())),
        float(distance.mean()),
        float(distance.max()),
        float(np.sqrt((turn**2).mean())),
        float(turn.mean()),
    )


def _track(rows: ArrayLike) -> Track:
    table = np.asarray(rows, np.float64).reshape(-1, 4)
    return table[np.argsort(table[:, 0], kind="stable")]
