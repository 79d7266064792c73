"""Sweeps become frames: what a source yields, checked, quantised and numbered."""

from __future__ import annotations

import numpy as np
from pydantic import ValidationError

from common.errors import BadSweep
from common.sweep import LaserGeometry, Sweep
from common.wire import Frame, LaserScan
from common.wire.codec import explain
from common.wire.robot import MINUS_INF_CODE


def pack(sweep: Sweep, robot: str, stream: str, seq: int, sensor: str = "laser", lossless: bool = False) -> Frame:
    """The frame that carries this sweep, ranges as uint16 counts of 1, 2 or 5 mm, or float32 when `lossless`.

    A laser that sees farther than uint16 can say (327 m) is sent as float32, too. NaN and infinite ranges mean what
    REP-117 says and travel; anything else that is no sound scan raises BadSweep with the reason.
    """
    geometry = sweep.geometry
    try:
        check(sweep)
        quantum = LaserScan.quantum_for(geometry.range_max)
        if lossless or geometry.range_max / quantum >= MINUS_INF_CODE:
            quantum, ranges = 0.0, np.asarray(sweep.ranges, np.float32)
        else:
            ranges = LaserScan.quantise(sweep.ranges, quantum)
        scan = LaserScan(
            angle_min=geometry.angle_min,
            angle_increment=geometry.angle_increment,
            range_min=geometry.range_min,
            range_max=geometry.range_max,
            time_increment=geometry.time_increment,
            mount=geometry.mount,
            quantum=quantum,
            ranges=ranges,
        )
        return Frame(
            robot=robot,
            stream=stream,
            seq=seq,
            stamp=sweep.stamp,
            sensor=sensor,
            scan=scan,
            odometry=sweep.odometry,
            imu=sweep.imu,
        )
    except ValidationError as error:
        raise BadSweep(f"scan at {sweep.stamp} s: {explain(error)}") from error


def check(sweep: Sweep) -> None:
    """Raises BadSweep for what no field of a message can see."""
    geometry = sweep.geometry
    reason = ""
    if len(sweep.ranges) == 0:
        reason = "no beams"
    elif geometry.angle_increment == 0 and len(sweep.ranges) > 1:
        reason = "angle_increment is 0"
    elif geometry.range_max <= geometry.range_min:
        reason = f"range_max {geometry.range_max} m is not above range_min {geometry.range_min} m"
    else:
        for name, samples in (("odometry", sweep.odometry), ("imu", sweep.imu)):
            if samples is not None and not np.isfinite(samples).all():
                reason = f"{name} holds NaN or infinity"
    if reason:
        raise BadSweep(f"scan at {sweep.stamp} s: {reason}")


def unpack(frame: Frame) -> Sweep | None:
    """The sweep in a frame, None when it is not a laser's."""
    scan = frame.scan
    if frame.kind != "laser" or scan is None:
        return None
    geometry = LaserGeometry(
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        time_increment=scan.time_increment,
        mount=scan.mount,
    )
    return Sweep(frame.stamp, geometry, scan.metres(), frame.odometry, frame.imu)
