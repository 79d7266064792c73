"""The messages that travel between robots, edges, cloud and scheduler: a closed union of frozen models."""

from common.wire.base import Cover, Covers, Epoch, Message, PoseTuple
from common.wire.cloud import CloudStatus, FixedPose, GlobalMapNotice, Placed, StageTimes, Trace, Transforms, Warp
from common.wire.codec import AnyMessage, decode, encode
from common.wire.edge import (
    Ack,
    Claims,
    Component,
    EdgeMapNotice,
    EdgeStatus,
    InstanceStatus,
    MapNotice,
    PairVerdict,
    PoseUpdate,
    Verdicts,
)
from common.wire.link import LinkStatus
from common.wire.pages import FramePage, Refusal, Tile, TilePage, TrajectoryPage
from common.wire.robot import EndOfStream, Frame, LaserScan, RobotProfile, RobotStatus
from common.wire.scheduler import OverlapMatrix, Plan, Route, Routes, SchedulerStatus

__all__ = [
    "Ack",
    "AnyMessage",
    "Claims",
    "CloudStatus",
    "Component",
    "Cover",
    "Covers",
    "EdgeMapNotice",
    "EdgeStatus",
    "EndOfStream",
    "Epoch",
    "FixedPose",
    "Frame",
    "FramePage",
    "GlobalMapNotice",
    "InstanceStatus",
    "LaserScan",
    "LinkStatus",
    "MapNotice",
    "Message",
    "OverlapMatrix",
    "PairVerdict",
    "Placed",
    "Plan",
    "PoseTuple",
    "PoseUpdate",
    "Refusal",
    "RobotProfile",
    "RobotStatus",
    "Route",
    "Routes",
    "SchedulerStatus",
    "StageTimes",
    "Tile",
    "TilePage",
    "Trace",
    "TrajectoryPage",
    "Transforms",
    "Verdicts",
    "Warp",
    "decode",
    "encode",
]
