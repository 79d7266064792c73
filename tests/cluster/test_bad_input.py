"""A robot that sends what no robot should: it is told, with its name, and everybody else goes on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import msgpack
import numpy as np
import pytest
from harness import Cluster, cluster, fleet

from common.bus import Bus, keys
from common.wire import EndOfStream, Frame, FramePage, LaserScan, Message, RobotProfile, encode
from common.wire.limits import MAX_MESSAGE_BYTES

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(240)]

STREAM = "b" * 32
NAN, INF = math.nan, math.inf
SCANS: list[list[float]] = [
    [1.0] * 90,
    [],
    [NAN] * 90,
    [INF] * 90,
    [-INF] * 7,
    [0.0] * 360,
    [1.0],
    [1e6] * 90,
    [2.0, NAN, INF, -INF] * 30,
    [1.5] * 91,
]
SPOILT = 5
"""number of the frame that is only in the spool, and is no frame there"""


def odd_frame(seq: int, robot: str = "bad") -> Frame:
    """Scans of any length and kind, and time that runs backwards in their middle."""
    ranges = np.array(SCANS[seq % len(SCANS)], np.float32)
    scan = LaserScan(angle_min=-3.0, angle_increment=0.07, range_min=0.1, range_max=8.0, quantum=0.0, ranges=ranges)
    stamp = 100.0 - seq if 10 <= seq < 15 else 0.1 * seq
    odometry = np.array([[stamp, 0.01 * seq, 0.0, 0.0]])
    odometry[0, 1] = NAN if seq == 12 else odometry[0, 1]
    return Frame(robot=robot, stream=STREAM, seq=seq, stamp=stamp, scan=scan, odometry=odometry)


def with_stamp(frame: Frame, stamp: float) -> bytes:
    """An encoded frame with a stamp that the message itself would refuse."""
    version, kind, fields = msgpack.unpackb(encode(frame))
    return msgpack.packb([version, kind, fields | {"stamp": stamp}])


class BadRobot:
    """A client of the bus that behaves like a robot otherwise."""

    def __init__(self, bus: Bus, frames: int) -> None:
        self._bus = bus
        self._spool = [encode(odd_frame(seq)) for seq in range(frames)]
        self._spool[SPOILT] = b"\x93no frame"

    async def come(self) -> None:
        await self._bus.serve(keys.robot_backfill("bad"), self._backfill)
        await self._bus.latch(keys.robot_profile("bad"), RobotProfile(robot="bad", stream=STREAM))
        await self._bus.declare_alive(keys.robot_alive("bad"))

    def send(self, data: bytes, robot: str = "bad") -> None:
        self._bus._session.put(f"{self._bus.root}/{keys.robot_frames(robot)}", data)

    async def end(self) -> None:
        for seq, data in enumerate(self._spool):
            if seq != SPOILT:
                self.send(data)
        end = EndOfStream(robot="bad", stream=STREAM, last_seq=len(self._spool) - 1)
        await self._bus.latch(keys.robot_end("bad"), end)

    async def _backfill(self, key: str, params: Mapping[str, str]) -> Message:
        start = int(params["from"])
        return FramePage(robot="bad", stream=STREAM, frames=tuple(self._spool[start:]), oldest=0)


async def misbehave(made: Cluster, robot: BadRobot) -> None:
    """Everything that is refused as a message; the edge says so and names who it was."""
    hostile = [
        b"",
        b"\xc1\xc1\xc1",
        bytes(MAX_MESSAGE_BYTES + 1),
        with_stamp(odd_frame(0), NAN),
        with_stamp(odd_frame(0), INF),
        encode(odd_frame(0, robot="r1")),
    ]
    for data in hostile:
        robot.send(data)
    robot.send(encode(odd_frame(0, robot="ghost")), robot="ghost")
    status = await made.edge_status("edge-1", lambda s: s.counters["messages refused"] >= len(hostile))
    assert all("robot/bad" in problem for problem in status.problems), status.problems
    assert any("speaks of robot 'r1'" in problem for problem in status.problems), status.problems


async def test_a_robot_that_sends_rubbish_is_named_and_harms_nobody(tmp_path: Path) -> None:
    async with cluster(fleet(("r1",), count=1), tmp_path) as made:
        await made.start_all("r1")
        async with await Bus.open(made.endpoint, name="bad", role="robot") as bus:
            robot = BadRobot(bus, frames=60)
            await robot.come()
            await made.edge_status("edge-1", lambda status: len(status.instances) == 1)
            await misbehave(made, robot)
            await robot.end()
            await made.start("r1")
            final = await made.final()
            assert (final.covers["r1"].seq, final.covers["bad"].seq) == (99, 59)
            status = await made.edge_status("edge-1", lambda s: [each.state for each in s.instances] == ["final"] * 2)
            bad, good = status.instances
            assert (bad.robot, bad.gaps, good.robot, good.gaps, good.skipped) == ("bad", 1, "r1", 0, 0)
        assert set(await made.stop()) == {0}
        assert made.faults() == []
