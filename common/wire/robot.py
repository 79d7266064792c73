"""What robots send."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field

from common.wire.arrays import ArrayOf
from common.wire.base import Message, Name, Part, PoseTuple, StreamId
from common.wire.limits import (
    MAX_ANGLE_RAD,
    MAX_BEAMS,
    MAX_MOUNT_M,
    MAX_RANGE_M,
    MAX_SAMPLES,
    MAX_STAMP_S,
    MAX_TIME_INCREMENT_S,
)

NAN_CODE, PLUS_INF_CODE, MINUS_INF_CODE = 65_535, 65_534, 65_533
"""uint16 codes of REP-117: invalid, nothing in range, too close."""

Angle = Annotated[float, Field(ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)]
Offset = Annotated[float, Field(ge=-MAX_MOUNT_M, le=MAX_MOUNT_M)]
Samples = Annotated[np.ndarray, ArrayOf("float64", columns=4, max_rows=MAX_SAMPLES)]


class LaserScan(Part):
    """One sweep with its full geometry; beam i points at `angle_min + i * angle_increment` (laser frame, rad)."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    angle_min: Angle
    angle_increment: Angle
    range_min: Annotated[float, Field(ge=0, le=MAX_RANGE_M)]
    range_max: Annotated[float, Field(gt=0, le=MAX_RANGE_M)]
    time_increment: Annotated[float, Field(ge=0, le=MAX_TIME_INCREMENT_S)] = 0.0
    """seconds between beams; 0 when the sweep is (or must be taken as) instantaneous"""
    mount: tuple[Offset, Offset, Angle] = (0.0, 0.0, 0.0)
    """pose of the laser in the robot's base frame"""
    quantum: Annotated[float, Field(ge=0, le=0.05, allow_inf_nan=False)]
    """metres per count of uint16 ranges; 0 when `ranges` are float32 metres"""
    ranges: (
        Annotated[np.ndarray, ArrayOf("uint16", max_rows=MAX_BEAMS)]
        | Annotated[np.ndarray, ArrayOf("float32", max_rows=MAX_BEAMS)]
    )

    @staticmethod
    def quantum_for(range_max: float) -> float:
        """The finest of 1, 2 and 5 mm in which `range_max` metres still fits."""
        return next((q for q in (0.001, 0.002, 0.005) if range_max / q < MINUS_INF_CODE), 0.005)

    @staticmethod
    def quantise(ranges: np.ndarray, quantum: float) -> np.ndarray:
        """float ranges in metres (n,) as uint16 counts, with codes for NaN, +inf and -inf."""
        with np.errstate(invalid="ignore", over="ignore"):
            counts = np.where(np.isfinite(ranges), np.rint(ranges / quantum), 0)
        out = np.clip(counts, 0, MINUS_INF_CODE - 1).astype(np.uint16)
        out[np.isnan(ranges)] = NAN_CODE
        out[ranges == np.inf] = PLUS_INF_CODE
        out[ranges == -np.inf] = MINUS_INF_CODE
        return out

    def metres(self) -> np.ndarray:
        """Ranges (n,) float32 in metres; NaN, +inf and -inf mean what REP-117 says."""
        if self.ranges.dtype == np.float32:
            return self.ranges
        out = self.ranges.astype(np.float32) * np.float32(self.quantum)
        out[self.ranges == NAN_CODE] = np.nan
        out[self.ranges == PLUS_INF_CODE] = np.inf
        out[self.ranges == MINUS_INF_CODE] = -np.inf
        return out

    def angles(self) -> np.ndarray:
        """Beam directions (n,) float64 in the laser frame, radians."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges))


class Frame(Message):
    """One sweep with the odometry and IMU samples since the frame before: the unit that a robot sends."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    robot: Name
    stream: StreamId
    seq: Annotated[int, Field(ge=0)]
    """counts from 0 within the stream, without gaps"""
    stamp: Annotated[float, Field(ge=-MAX_STAMP_S, le=MAX_STAMP_S)]
    """seconds, robot's clock"""
    stamp_at: Literal["sweep_start", "sweep_middle", "sweep_end"] = "sweep_start"
    kind: Annotated[str, Field(max_length=32)] = "laser"
    """kinds that the edge does not know are counted and skipped"""
    sensor: Annotated[str, Field(max_length=64)] = "laser"
    scan: LaserScan | None = None
    odometry: Samples | None = None
    """(n, 4): stamp s, x m, y m, theta rad in the odometry frame; the last sample may lie after `stamp`"""
    imu: Samples | None = None
    """(n, 4): stamp s, yaw rate rad/s, acceleration x and y m/s^2 in the base frame"""
    data: Annotated[bytes, Field(max_length=1 << 20)] = b""
    """payload of kinds other than "laser" """


class EndOfStream(Message):
    """The robot will send nothing after `last_seq` (-1: it sent nothing at all)."""

    robot: Name
    stream: StreamId
    last_seq: int


class RobotProfile(Message):
    """What is known of a robot before its first frame."""

    robot: Name
    stream: StreamId
    sensor: str = ""
    range_max: float = 0.0
    start: PoseTuple | None = None
    """pose in the world at the first frame, where the operator knows it"""
    edges: tuple[Name, ...] | None = None
    """edges that this robot can reach; None: all"""


class RobotStatus(Message):
    robot: Name
    stream: StreamId
    sent: int
    """frames numbered so far"""
    processed: int
    """last frame that the edge has processed, -1 for none"""
    spooled: int
    spool_bytes: int
    dropped: int
    """unacknowledged frames lost to a full spool"""
    backfilled: int
    edge: str = ""
    ended: bool = False
    refused: int = 0
    """scans of the source that could not be packed"""
    pack_s: float = 0.0
    """mean time to pack and spool one frame"""
    bytes_sent: int = 0
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    source: str = ""
