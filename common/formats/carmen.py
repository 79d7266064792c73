"""CARMEN logs as sweeps: lasers with odometry, in the order of their stamps.

A log holds one message a line, every line ending in `ipc_timestamp host logger_timestamp`. The stamp used is the
IPC timestamp, digit for digit, because the published relations name poses by it.

Stamps of real logs are not in order: old loggers wrote microseconds without leading zeros, so that a tenth of
the rows is stamped up to 0.9 s late. Which rows these are shows only by the order of the lines. A scan is never
thrown away for that: its line holds the odometry pose it was taken at, so it is right at any stamp, and scans are
sorted. An ODOM row that contradicts the order of its neighbours would bend the odometry track, and is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile
from common.formats.order import longest_rising
from common.formats.text import numbered_lines
from common.geometry import between
from common.sweep import LaserGeometry, Sweep
from common.wire.base import PoseTuple

USUAL_RANGE_MAX = 50.0
"""m; taken when the log states none. Scanners of these logs mark `nothing there` by 50 or by 81.9 m."""
MAX_DISORDER_S = 5.0
"""Stamps that are further than this from those around are a clock that was set, not a late stamp."""
MAX_MOUNT_M = 1.0
"""Laser and robot pose further apart than this are a corrected and a raw pose, not a mount."""

LASERS = ("ROBOTLASER1", "FLASER", "ROBOTLASER2", "RLASER", "RAWLASER1", "RAWLASER2", "RAWLASER3", "RAWLASER4")
"""Kinds of laser rows, in the order in which one is chosen when a log holds several."""
RANGE_MAX_PARAMS = {
    "FLASER": ("robot_front_laser_max", "robot_frontlaser_max"),
    "RLASER": ("robot_rear_laser_max", "robot_rearlaser_max"),
}


@dataclass(frozen=True)
class _Scan:
    stamp: float
    geometry: LaserGeometry
    ranges: NDArray[np.float32]
    robot: PoseTuple | None
    order: int
    """number of its line"""


class CarmenLog:
    """One laser of a CARMEN log, read whole at once: iterate over it for its sweeps, as often as you like.

    `laser` names the kind of row (`FLASER`, ...); None takes the first of LASERS that the log holds.
    `range_max` (m) overrides what the log says: readings of it or more become +inf. Raises BadFile when the file
    cannot be read or holds no row of that laser; rows that are malformed or out of time are counted.
    """

    def __init__(self, path: str | Path, laser: str | None = None, range_max: float | None = None) -> None:
        self.path = Path(path)
        self.malformed = 0
        """rows that could not be parsed"""
        self.first_malformed = ""
        """where and why"""
        self.disordered = 0
        """rows left out because their stamps contradict the order of the lines"""
        self.other = 0
        """rows of kinds that are not used (other lasers among them)"""
        self._params: dict[str, str] = {}
        self.laser = laser or self._choose_laser()
        if self.laser not in LASERS:
            raise BadFile(f"{self.path}: {self.laser!r} is no laser; take one of {', '.join(LASERS)}")
        self._range_max = range_max
        self._mount: PoseTuple | None = None
        self._sweeps = self._assemble(*self._read())
        if not self._sweeps:
            raise BadFile(
                f"{self.path}: holds no usable {self.laser} row "
                f"({self.malformed} malformed, {self.disordered} with stamps out of order)"
            )

    def __iter__(self) -> Iterator[Sweep]:
        return iter(self._sweeps)

    def __len__(self) -> int:
        return len(self._sweeps)

    def summary(self) -> str:
        """One line for the operator: what was read and what was not."""
        text = f"{self.path}: {len(self)} {self.laser} sweeps; skipped {self.malformed} malformed rows, "
        text += f"{self.disordered} with stamps out of order"
        return text + (f"; first malformed: {self.first_malformed}" if self.malformed else "")

    def _choose_laser(self) -> str:
        kinds = {line.split(None, 1)[0] for _, line in numbered_lines(self.path)}
        found = next((kind for kind in LASERS if kind in kinds), None)
        if found is None:
            raise BadFile(f"{self.path}: holds no laser rows ({', '.join(LASERS)}); is it a CARMEN log?")
        return found

    def _read(self) -> tuple[list[_Scan], NDArray[np.float64]]:
        """All scans and odometry rows (n, 5): stamp, x, y, theta, line; in the order of the lines."""
        scans: list[_Scan] = []
        odometry: list[tuple[float, float, float, float, int]] = []
        for number, line in numbered_lines(self.path):
            fields = line.split()
            try:
                if fields[0] == self.laser:
                    scans.append(self._scan(fields, number))
                elif fields[0] == "ODOM":
                    odometry.append((_number(fields[7]), *_pose(fields[1:4]), number))
                elif fields[0] == "PARAM":
                    self._params[fields[1]] = fields[2]
                else:
                    self.other += 1
            except (ValueError, IndexError) as error:
                self.malformed += 1
                self.first_malformed = self.first_malformed or f"{self.path}:{number}: {error}"
        return scans, np.array(odometry, np.float64).reshape(-1, 5)

    def _scan(self, fields: list[str], number: int) -> _Scan:
        if self.laser in ("FLASER", "RLASER"):
            return self._plain_scan(fields, number)
        return self._described_scan(fields, number)

    def _plain_scan(self, fields: list[str], number: int) -> _Scan:
        """`FLASER n r1..rn laser_pose robot_pose stamp ..`: 180 degrees, right to left, centred on forward."""
        n, tail = _list(fields, 1)
        beams, rest = fields[2:tail], fields[tail:]
        laser, robot, stamp = _pose(rest[:3]), _pose(rest[3:6]), _number(rest[6])
        if n < 2:
            raise ValueError(f"{n} beams")
        step = math.pi / (n - 1 if n % 2 else n)
        front = 0.0 if self.laser == "FLASER" else math.pi
        mount = self._mounted(laser, robot)
        # A rear laser's pose may be given as the robot's own: then it is the direction that is missing.
        turned = front if abs(mount[2]) < math.pi / 2 else 0.0
        far = self._range_max or self._stated_range_max()
        geometry = LaserGeometry(turned - math.pi / 2, step, 0.0, far, 0.0, mount)
        return _Scan(stamp, geometry, _ranges(beams, far), robot, number)

    def _described_scan(self, fields: list[str], number: int) -> _Scan:
        """`ROBOTLASERk` or `RAWLASERk`: type start fov step max accuracy remission_mode, readings, remissions."""
        start, _, step, far = (_number(f) for f in fields[2:6])
        _, after = _list(fields, 8)
        _, tail = _list(fields, after)
        beams, rest = fields[9:after], fields[tail:]
        robot, mount = None, (0.0, 0.0, 0.0)
        if self.laser.startswith("ROBOT"):
            laser, robot = _pose(rest[:3]), _pose(rest[3:6])
            mount, rest = self._mounted(laser, robot), rest[11:]
        far = self._range_max or far
        if step == 0 or far <= 0:
            raise ValueError(f"angular step {step}, maximum range {far}")
        geometry = LaserGeometry(start, step, 0.0, far, 0.0, mount)
        return _Scan(_number(rest[0]), geometry, _ranges(beams, far), robot, number)

    def _stated_range_max(self) -> float:
        for name in RANGE_MAX_PARAMS[self.laser]:
            if name in self._params:
                return _number(self._params[name])
        return USUAL_RANGE_MAX

    def _mounted(self, laser: PoseTuple, robot: PoseTuple) -> PoseTuple:
        """The laser on the robot, from the first row (poses are rounded: later rows would only jitter)."""
        if self._mount is None:
            x, y, theta = (float(v) for v in np.round(between(robot, laser), 4) + 0.0)
            self._mount = (x, y, theta) if math.hypot(x, y) <= MAX_MOUNT_M else (0.0, 0.0, 0.0)
        return self._mount

    def _assemble(self, scans: list[_Scan], odometry: NDArray[np.float64]) -> list[Sweep]:
        scans, odometry = self._in_time(scans, odometry)
        own = [(scan.stamp, *scan.robot) for scan in scans if scan.robot is not None]
        samples = np.concatenate([odometry[:, :4], np.array(own, np.float64).reshape(-1, 4)])
        samples = samples[np.argsort(samples[:, 0], kind="stable")]
        ends = np.searchsorted(samples[:, 0], [scan.stamp for scan in scans], side="right")
        starts = np.concatenate([[0], ends])[: len(scans)]
        return [
            Sweep(scan.stamp, scan.geometry, scan.ranges, samples[a:b] if len(samples) else None)
            for scan, a, b in zip(scans, starts, ends, strict=True)
        ]

    def _in_time(self, scans: list[_Scan], odometry: NDArray[np.float64]) -> tuple[list[_Scan], NDArray[np.float64]]:
        """Scans by rising stamps, and the odometry rows that agree with them and with each other."""
        stamps = np.concatenate([[scan.stamp for scan in scans], odometry[:, 0]])
        lines = np.concatenate([[scan.order for scan in scans], odometry[:, 4]])
        is_scan = np.arange(len(stamps)) < len(scans)
        order = np.argsort(lines)
        keep = np.empty(len(stamps), bool)
        keep[order] = _steady(stamps[order])
        rows = order[keep[order]]
        t, scan_rows = stamps[rows], is_scan[rows]
        later = np.append(np.minimum.accumulate(t[::-1])[::-1][1:], np.inf)
        passed = np.concatenate([[-np.inf], np.maximum.accumulate(np.where(scan_rows, t, -np.inf))[:-1]])
        contradicts = ~scan_rows & ((t > later) | (t < passed))
        repeats = ~scan_rows & ((t == later) | (t == passed))  # the scan's own pose, or the later row, stands for it
        unique = {scan.stamp: scan for i, scan in reversed(list(enumerate(scans))) if keep[i]}
        self.disordered = int((~keep).sum() + contradicts.sum() + keep[: len(scans)].sum()) - len(unique)
        good = np.sort(rows[~scan_rows & ~contradicts & ~repeats]) - len(scans)
        return [unique[stamp] for stamp in sorted(unique)], odometry[good]


def _steady(t: NDArray[np.float64]) -> NDArray[np.bool_]:
    """False for rows stamped by a clock that was wrong for a while, or set: far from the rows around that rise."""
    rising = longest_rising(t)
    lines = np.arange(len(t))
    before = np.append(-np.inf, t[rising])[np.searchsorted(rising, lines, side="right")]
    after = np.append(t[rising], np.inf)[np.searchsorted(rising, lines, side="left")]
    return np.asarray((t >= before - MAX_DISORDER_S) & (t <= after + MAX_DISORDER_S))


def _number(field: str) -> float:
    value = float(field)
    if not math.isfinite(value):
        raise ValueError(f"{field} where a number belongs")
    return value


def _pose(fields: list[str]) -> PoseTuple:
    x, y, theta = (_number(field) for field in fields)
    return x, y, theta


def _list(fields: list[str], at: int) -> tuple[int, int]:
    """Length of the list whose length stands in `fields[at]`, and where the fields after it begin."""
    n = int(fields[at])
    if n < 0 or at + 1 + n > len(fields):
        raise ValueError(f"{n} readings announced, {len(fields) - at - 1} fields there")
    return n, at + 1 + n


def _ranges(fields: list[str], range_max: float) -> NDArray[np.float32]:
    """Readings in metres by REP-117: at or beyond the maximum is nothing in range, 0 and below is invalid."""
    with np.errstate(invalid="ignore", over="ignore"):
        ranges = np.array([float(field) for field in fields], np.float32)
        ranges[ranges >= np.float32(range_max)] = np.inf
        ranges[ranges <= 0] = np.nan
    return ranges
