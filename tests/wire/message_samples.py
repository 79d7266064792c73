"""One message of each kind, every field set."""

from __future__ import annotations

import numpy as np

from common.wire import (
    Ack,
    Claims,
    CloudStatus,
    Component,
    Cover,
    EdgeMapNotice,
    EdgeStatus,
    EndOfStream,
    FixedPose,
    Frame,
    FramePage,
    GlobalMapNotice,
    InstanceStatus,
    LaserScan,
    MapNotice,
    Message,
    OverlapMatrix,
    PairVerdict,
    Placed,
    Plan,
    PoseUpdate,
    Refusal,
    RobotProfile,
    RobotStatus,
    Route,
    Routes,
    SchedulerStatus,
    StageTimes,
    Tile,
    TilePage,
    Trace,
    TrajectoryPage,
    Transforms,
    Verdicts,
)

STREAM = "0123456789abcdef" * 2
POSE = (1.5, -2.25, 0.125)
COVER = Cover(stream=STREAM, seq=9, epoch=(1, 2))
COMPONENT = Component(id="r1", robots=("r1", "r2"), transforms={"r1": (0.0, 0.0, 0.0), "r2": POSE})
TIMES = StageTimes(pack=0.25, transfer=0.5, slam=0.75, fuse=1.0)
SCAN = LaserScan(
    angle_min=-1.5,
    angle_increment=0.5,
    range_min=0.125,
    range_max=12.0,
    time_increment=0.0,
    mount=POSE,
    quantum=0.001,
    ranges=np.array([0, 1000, 65535], np.uint16),
)

SAMPLES: dict[str, Message] = {
    type(message).__name__: message
    for message in (
        Frame(
            robot="r1",
            stream=STREAM,
            seq=3,
            stamp=4.5,
            scan=SCAN,
            odometry=np.array([[4.0, 1.0, 2.0, 0.5]]),
            imu=np.zeros((0, 4)),
            data=b"\x00\xff",
        ),
        EndOfStream(robot="r1", stream=STREAM, last_seq=-1),
        RobotProfile(robot="r1", stream=STREAM, sensor="lds01", range_max=3.5, start=POSE, edges=("e1", "e2")),
        RobotStatus(
            robot="r1",
            stream=STREAM,
            sent=10,
            processed=-1,
            spooled=3,
            spool_bytes=4096,
            dropped=1,
            backfilled=2,
            edge="e1",
            ended=True,
            refused=1,
            pack_s=0.5,
            bytes_sent=70000,
            cpu_s=1.5,
            rss_mb=30.25,
            source="sim",
        ),
        Ack(robot="r1", edge="e1", stream=STREAM, epoch=(1, 2), processed=7, durable=5, window=64),
        PoseUpdate(robot="r1", edge="e1", seq=7, stamp=4.5, pose=POSE),
        MapNotice(
            robot="r1", edge="e1", epoch=(1, 2), version=4, resolution=0.05, cover=COVER, final=False, slam_s=1.5
        ),
        Verdicts(
            owner="edge/e1",
            pairs=(PairVerdict(a="r1", b="r2", kind="merged", versions=(3, 4), transform=POSE, overlap=0.25),),
        ),
        EdgeMapNotice(
            edge="e1",
            version=2,
            world_epoch=1,
            resolution=0.05,
            components=(COMPONENT,),
            covers={"r1": COVER},
            final=True,
            fuse_s=0.5,
            transfer_s=0.25,
        ),
        Claims(edge="e1", claims={"r1": (1, 2)}, epoch=(1, 3)),
        EdgeStatus(
            edge="e1",
            cores=2,
            cpu_s=0.5,
            rss_mb=100.0,
            instances=(
                InstanceStatus(
                    robot="r1", state="running", processed=7, pending=1, worker=0, scan_ms=1.5, gaps=0, skipped=0
                ),
            ),
            fusing=("r1",),
            stages={"fuse": 0.5},
            counters={"dropped": 1},
            bytes_in=1,
            bytes_out=2,
            problems=("robot/r9: no",),
        ),
        Transforms(
            world_epoch=3,
            final=True,
            resolution=0.05,
            robots={
                "r1": Placed(transform=FixedPose(x_um=1, y_um=-2, theta_nrad=3), component="r1", version=4),
            },
            components=(COMPONENT,),
            reason="first",
        ),
        GlobalMapNotice(
            version=1,
            world_epoch=3,
            final=True,
            resolution=0.05,
            digest="ab" * 32,
            components=(COMPONENT,),
            covers={"r1": COVER},
            trace=Trace(robots={"r1": TIMES}, edges={"e1": TIMES}, cloud=TIMES, total_s=2.5, critical=("r1", "e1")),
        ),
        CloudStatus(
            version=1,
            world_epoch=3,
            robots=("r1",),
            components=1,
            cpu_s=0.5,
            rss_mb=90.5,
            stages={"merge": 0.5},
            counters={"refused": 0},
        ),
        Routes(epoch=(1, 2), routes={"r1": Route(slam_edge="e1", fuse_edge="e2", epoch=(1, 1))}),
        OverlapMatrix(robots=("r1", "r2"), weights=np.array([0.0, 0.25, 0.25, 0.0]), source={"sketch": 1}),
        Plan(
            epoch=(1, 2),
            policy="paper",
            groups={"e1": ("r1", "r2")},
            in_group={"e1": 0.25},
            cut=0.0,
            predicted={"t_c": 1.5},
            alternative="random",
            reason="better by 12 %",
            seconds=0.001,
        ),
        SchedulerStatus(
            epoch=(1, 2),
            policy="paper",
            robots={"r1": "alive"},
            edges={"e1": "alive"},
            plans=1,
            moved=0,
            stages={"plan": 0.001},
            counters={"refused": 0},
        ),
        FramePage(robot="r1", stream=STREAM, frames=(b"abc", b""), oldest=0, next=2),
        TilePage(
            source="edge/e1",
            kind="counts",
            resolution=0.05,
            version=4,
            tiles=(Tile(x=-1, y=2, version=3, data=b"\x01\x02"), Tile(x=0, y=0, version=4, data=b"")),
            covers={"r1": COVER},
            final=False,
            world_epoch=1,
            next="4:1",
        ),
        TrajectoryPage(robot="r1", version=4, poses=np.array([[4.5, 1.0, 2.0, 0.5]]), next=1),
        Refusal(reason="no such stream"),
    )
}
