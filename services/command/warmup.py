"""Compiles all kernels once; they are kept on disk, and every process after this loads them in no time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator


def warmup() -> Iterator[tuple[str, float]]:
    """Yields (what, seconds) as each part is ready."""
    from common.fusion.warmup import warmup as fusion
    from services.edge_worker.slam.warmup import warmup as slam
    from services.scheduler.warmup import warmup as planning

    parts: tuple[tuple[str, Callable[[], None]], ...] = (
        ("simulator", _simulator),
        ("SLAM", slam),
        ("fusion", fusion),
        ("planning", planning),
    )
    for name, compile_part in parts:
        started = time.monotonic()
        compile_part()
        yield name, time.monotonic() - started


def _simulator() -> None:
    from common.sim import SimulatedRobot, load_scene
    from common.sim.truth import visible_area, visible_walls

    scene = load_scene("asymmetric")
    robot = SimulatedRobot(scene, "r1", 0, peers=("r2",), duration_s=1.0)
    for _ in robot.sweeps():
        pass
    visible_walls(scene, [robot], 0.5)
    visible_area(scene, [robot], 0.5)
