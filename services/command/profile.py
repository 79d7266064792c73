"""`recslam profile`: what SLAM and fusion cost on this machine, timed in the very worker processes that edges use."""

from __future__ import annotations

import asyncio
import platform
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import tomli_w

from common.wire import Frame, encode
from common.workers import Worker
from services.edge_worker.slam.registry import create
from services.scheduler.costs import FusionModel
from services.scheduler.profile import FusionTime, Profile
from services.scheduler.regression import FusionTimes

SLAM = "services.edge_worker.slam.host:SlamHost"
FUSION = "services.edge_worker.fusion_host:FusionHost"
SCENE = "apartment"
SENSORS = ("lds01", "rplidar_a1", "sick")
MAPPER = "rplidar_a1"
MAPS = (2, 3, 4, 6, 8, 12)
PAGE_BYTES = 1 << 24
STREAM = "0" * 32


async def profile(kernel: str, seconds: float, out: Path) -> AsyncIterator[str]:
    """Time scans of simulated drives of `seconds` and fusions of 2 to 12 maps; yields a line for each, writes `out`.

    Raises ConfigError for an unknown kernel, and OSError when there is no folder for `out`, before anything is timed.
    """
    create(kernel, {})
    out.parent.mkdir(parents=True, exist_ok=True)
    slam_s: dict[str, float] = {}
    maps: list[dict[str, Any]] = []
    worker = await Worker.start(SLAM)
    try:
        await worker.call("warm", kernel=kernel)
        for sensor in SENSORS:
            slam_s[sensor], _ = await _drive(worker, kernel, "r1", sensor, seconds)
            yield f"SLAM {kernel}, {sensor}: {1e3 * slam_s[sensor]:.2f} ms a scan"
        for number in range(max(MAPS)):
            maps.append((await _drive(worker, kernel, f"r{number}", MAPPER, seconds))[1])
    finally:
        await worker.close()
    fusions: list[FusionTime] = []
    async for each in _fusions(maps):
        fusions.append(each)
        yield f"fusion of {each.maps} maps, {each.area_m2:.0f} m2: {each.seconds:.3f} s"
    made = fitted(slam_s, fusions, kernel)
    await asyncio.to_thread(out.write_text, tomli_w.dumps(made.model_dump()))
    yield f"fusion: {made.map_s:.4f} s a map, {made.pair_s:.4f} s a pair, {made.m2_s:.2e} s a square metre"


def simulated(robot: str, sensor: str, seconds: float) -> Iterator[Frame]:
    """Frames of one robot on its way through the apartment."""
    from common.sim import SimulatedRobot, load_scene
    from services.robot_agent.packing import pack

    driver = SimulatedRobot(load_scene(SCENE), robot, 0, lidar=sensor, duration_s=seconds)
    for seq, sweep in enumerate(driver.sweeps()):
        yield pack(sweep, robot, STREAM, seq, sensor)


async def _drive(worker: Worker, kernel: str, robot: str, sensor: str, seconds: float) -> tuple[float, dict[str, Any]]:
    """(median seconds of a scan, the robot map as FusionHost.put takes it)."""
    await worker.call("open", robot=robot, life=1, kernel=kernel, settings={}, seed=0)
    for frame in simulated(robot, sensor, seconds):
        await worker.call("process", robot=robot, data=encode(frame))
    news = await worker.call("news", robot=robot)
    page = await worker.call("tiles", robot=robot, kind="counts", since=0, cursor="", limit_bytes=PAGE_BYTES)
    tiles = [(x, y, data) for x, y, _, data in page["tiles"]]
    await worker.call("close", robot=robot, life=1)
    drawn = {"resolution": page["resolution"], "version": page["version"], "tiles": tiles}
    return news["scan_s"], drawn


async def _fusions(maps: list[dict[str, Any]]) -> AsyncIterator[FusionTime]:
    """Each fusion from nothing: no pair is known before."""
    worker = await Worker.start(FUSION)
    try:
        await worker.call("warm")
        for count in MAPS:
            names = [f"r{number}" for number in range(count)]
            for name, drawn in zip(names, maps, strict=False):
                await worker.call("put", robot=name, final=False, cover={}, whole=True, **drawn)
            done = await worker.call("fuse", edge="profile", robots=names, world=None)
            yield FusionTime(maps=count, area_m2=done["area_m2"], seconds=done["seconds"])
            for name in names:
                await worker.call("forget", robot=name)
    finally:
        await worker.close()


def fitted(slam_s: dict[str, float], fusions: list[FusionTime], kernel: str) -> Profile:
    """The profile, with the fusion model that these times give."""
    times = FusionTimes(FusionModel())
    for each in fusions:
        times.took(each.maps, each.area_m2, each.seconds)
    model = times.model
    return Profile(
        machine=f"{platform.node()}, {platform.machine()}, Python {platform.python_version()}",
        kernel=kernel,
        slam_s=slam_s,
        map_s=model.map_s,
        pair_s=model.pair_s,
        m2_s=model.m2_s,
        fusions=tuple(fusions),
    )
