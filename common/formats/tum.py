"""TUM trajectories: rows `stamp x y z qx qy qz qw`, here in the plane (z, qx and qy are 0)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import BadFile
from common.formats.text import numbered_lines


def write_trajectory(path: str | Path, trajectory: ArrayLike) -> None:
    """Write (n, 4) of stamp s, x m, y m, theta rad. Stamps keep 9 decimals, what a double can tell of today."""
    rows = np.asarray(trajectory, np.float64).reshape(-1, 4)
    if not np.isfinite(rows).all():
        raise BadFile(f"{path}: a trajectory to write holds NaN or infinity; leave such rows out")
    half = rows[:, 3] / 2
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for (t, x, y, _), sin, cos in zip(rows, np.sin(half), np.cos(half), strict=True):
        lines.append(f"{t:.9f} {x:.9f} {y:.9f} 0 0 0 {sin:.12f} {cos:.12f}")
    Path(path).write_text("\n".join(lines) + "\n")


def read_trajectory(path: str | Path) -> NDArray[np.float64]:
    """(n, 4) of stamp s, x m, y m, theta rad in [-pi, pi], in the order of the file (gzipped or plain).

    Of a trajectory in space, its shadow on the plane: x, y and yaw. Rows `stamp x y theta` are taken as well.
    Raises BadFile naming file and line.
    """
    rows = []
    for number, line in numbered_lines(path):
        try:
            values = [float(field) for field in line.replace(",", " ").split()]
        except ValueError as error:
            raise BadFile(f"{path}:{number}: {error}") from error
        if len(values) not in (4, 8) or not np.isfinite(values).all():
            raise BadFile(f"{path}:{number}: expected 8 finite numbers (or `stamp x y theta`), got {line!r}")
        rows.append(values[:4] if len(values) == 4 else [*values[:3], _yaw(*values[4:])])
    return np.array(rows, np.float64).reshape(-1, 4)


def _yaw(qx: float, qy: float, qz: float, qw: float) -> float:
    """Yaw of a quaternion of any length but 0."""
    return float(np.arctan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))
