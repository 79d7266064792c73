"""Logs of the tinySLAM rover: a Hokuyo URG-04LX (240 degrees) and two wheel encoders.

A row holds, counted from 1: the stamp in microseconds, left and right encoder counts in columns 3 and 4, and
ranges in mm from column 25 on. Ranges below 20 are the scanner's error codes (0: nothing measured).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import BadFile
from common.formats.order import longest_rising
from common.formats.text import numbered_lines
from common.geometry import wrap
from common.sweep import LaserGeometry, Sweep

METRES_PER_TICK = 2 * math.pi * 0.077 / 2000
"""wheels of 77 mm radius, 2000 ticks a turn"""
AXLE_M = 2 * 0.165
STEP = 2 * math.pi / 1024
"""rad between beams of a URG-04LX, the middle one straight ahead"""
TURN_S = 0.1
"""s in which a URG-04LX looks around once"""
LATENCY_S = 0.15
"""s from a scan's first beam to the row that it is logged in, with the wheels as they are by then: a turn of the mirror
and the transfer. With it, turns by wheels and by matched scans agree three times better than without."""
RANGE_MIN_M, RANGE_MAX_M = 0.02, 5.6
MOUNT = (0.145, 0.0, 0.0)
FIRST_RANGE = 24
MIN_FIELDS = FIRST_RANGE + 2


class RoverLog:
    """One run of the rover, read whole at once: iterate over it for its sweeps, as often as you like.

    Stamps are seconds of the rover's clock; odometry starts at (0, 0, 0), one sample a sweep, of when it was logged.
    Raises BadFile when the file cannot be read or holds no such row; malformed rows and rows whose stamps contradict
    the order of the lines are counted.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.malformed = 0
        """rows that could not be parsed"""
        self.first_malformed = ""
        """where and why"""
        self.disordered = 0
        """rows left out because their stamps contradict the order of the lines"""
        rows = self._read()
        if not rows:
            raise BadFile(f"{self.path}: holds no usable row ({self.malformed} malformed); is it a rover log?")
        track = dead_reckon(np.array([row[1:3] for row in rows]))
        self._sweeps = [
            Sweep(stamp - LATENCY_S, _geometry(len(ranges)), ranges, np.array([[stamp, *pose]]))
            for (stamp, _, _, ranges), pose in zip(rows, track, strict=True)
        ]

    def __iter__(self) -> Iterator[Sweep]:
        return iter(self._sweeps)

    def __len__(self) -> int:
        return len(self._sweeps)

    def summary(self) -> str:
        """One line for the operator: what was read and what was not."""
        text = f"{self.path}: {len(self)} sweeps; skipped {self.malformed} malformed rows, "
        text += f"{self.disordered} with stamps out of order"
        return text + (f"; first malformed: {self.first_malformed}" if self.malformed else "")

    def _read(self) -> list[tuple[float, float, float, NDArray[np.float32]]]:
        rows: list[tuple[float, float, float, NDArray[np.float32]]] = []
        for number, line in numbered_lines(self.path):
            try:
                values = np.array([float(field) for field in line.split()])
                if len(values) < MIN_FIELDS or not np.isfinite(values).all():
                    raise ValueError(f"expected at least {MIN_FIELDS} finite numbers, got {len(values)} fields")
            except ValueError as error:
                self.malformed += 1
                self.first_malformed = self.first_malformed or f"{self.path}:{number}: {error}"
                continue
            with np.errstate(over="ignore"):
                ranges = (values[FIRST_RANGE:] / 1000).astype(np.float32)
            ranges[ranges < RANGE_MIN_M] = np.nan
            ranges[ranges > RANGE_MAX_M] = np.inf
            rows.append((float(values[0]) * 1e-6, float(values[2]), float(values[3]), ranges))
        rising = longest_rising([row[0] for row in rows])
        self.disordered = len(rows) - len(rising)
        return [rows[i] for i in rising]


def dead_reckon(ticks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (n, 3) of a differential drive from its left and right counts (n, 2), beginning at (0, 0, 0).

    Each step is an arc, taken as its chord at the mean heading.
    """
    left, right = (np.diff(ticks, axis=0, prepend=ticks[:1]) * METRES_PER_TICK).T
    theta = np.cumsum((right - left) / AXLE_M)
    middle, ahead = theta - (right - left) / AXLE_M / 2, (left + right) / 2
    track = np.column_stack([np.cumsum(ahead * np.cos(middle)), np.cumsum(ahead * np.sin(middle)), wrap(theta)])
    return track


def _geometry(beams: int) -> LaserGeometry:
    time_increment = TURN_S * STEP / (2 * math.pi)
    return LaserGeometry(-STEP * (beams - 1) / 2, STEP, RANGE_MIN_M, RANGE_MAX_M, time_increment, MOUNT)
