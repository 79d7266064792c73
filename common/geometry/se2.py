"""SE(2) on numpy arrays: a pose is `(x, y, theta)` in metres and radians, batches have shape (..., 3).

A pose of frame B in frame A maps points of B to A: `apply(pose, points_b) -> points_a`.
All functions broadcast over leading dimensions and return float64. A single pose takes the same path as a batch, but in
plain numbers: arrays of one number each would cost ten times as much.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Pose = NDArray[np.float64]

IDENTITY: Pose = np.zeros(3)
IDENTITY.setflags(write=False)


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """Angle(s) in radians, brought to [-pi, pi)."""
    return np.asarray(_wrapped(np.asarray(angle, dtype=np.float64)))


def compose(a: ArrayLike, b: ArrayLike) -> Pose:
    """The pose `b`, given in the frame of `a`, in the frame that `a` is given in."""
    (ax, ay, turn), (bx, by, more) = _parts(a), _parts(b)
    c, s = np.cos(turn), np.sin(turn)
    return _joined(ax + c * bx - s * by, ay + s * bx + c * by, turn + more)


def inverse(a: ArrayLike) -> Pose:
    """The pose that undoes `a`."""
    x, y, turn = _parts(a)
    c, s = np.cos(turn), np.sin(turn)
    return _joined(-c * x - s * y, s * x - c * y, -turn)


def between(a: ArrayLike, b: ArrayLike) -> Pose:
    """The pose `b` in the frame of `a`, both given in one common frame."""
    return compose(inverse(a), b)


def apply(pose: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points (n, 2) of the pose's own frame, in the frame that the pose is given in."""
    pose, points = np.asarray(pose, dtype=np.float64), np.asarray(points, dtype=np.float64)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.stack(
        [pose[0] + c * points[:, 0] - s * points[:, 1], pose[1] + s * points[:, 0] + c * points[:, 1]],
        axis=-1,
    )


def interpolate(stamps: ArrayLike, poses: ArrayLike, at: ArrayLike) -> Pose:
    """Poses (m, 3) at the times `at` (m,), along the track `stamps` (n,), `poses` (n, 3).

    Linear in x and y, the short way round in theta, held beyond the ends. Stamps must not fall.
    """
    stamps, poses, at = (np.asarray(v, dtype=np.float64) for v in (stamps, poses, at))
    theta = np.unwrap(poses[:, 2])
    return np.stack(
        [
            np.interp(at, stamps, poses[:, 0]),
            np.interp(at, stamps, poses[:, 1]),
            wrap(np.interp(at, stamps, theta)),
        ],
        axis=-1,
    )


def _parts(poses: ArrayLike) -> tuple[Any, Any, Any]:
    """x, y, theta: numbers of one pose, arrays of many."""
    poses = np.asarray(poses, dtype=np.float64)
    if poses.shape == (3,):
        x, y, theta = poses.tolist()
        return x, y, theta
    return poses[..., 0], poses[..., 1], poses[..., 2]


def _joined(x: Any, y: Any, theta: Any) -> Pose:
    """The inverse of `_parts`, theta wrapped."""
    parts = x, y, _wrapped(theta)
    return np.array(parts) if np.ndim(x) == 0 else np.stack(parts, axis=-1)


def _wrapped(angle: Any) -> Any:
    """A number or an array of them, in radians, brought to [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
