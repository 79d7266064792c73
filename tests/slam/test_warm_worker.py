"""Promises of a warm worker."""

from __future__ import annotations

import subprocess
import sys

import pytest

RUN = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from common.grid.standing import stands
from common.sim import SimulatedRobot, load_scene
from services.edge_worker.slam.host import SlamHost
from services.edge_worker.slam.registry import create
from services.robot_agent.packing import pack

def loaded():
    known = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    ours = [d for d in known if d.py_func.__module__.startswith(("services.", "common.grid."))]
    return {(d.py_func.__qualname__, str(s)) for d in ours for s in d.signatures}

kernel = sys.argv[1]
SlamHost().warm(kernel)
warm = loaded()
for measured in (True, False):
    robot = SimulatedRobot(load_scene("apartment"), "r1", 1, duration_s=10.0, imu=measured, wheels=measured)
    slam = create(kernel, {}, 1)
    for seq, sweep in enumerate(robot.sweeps()):
        if seq % 30 == 20:
            data = slam.snapshot()
            slam = create(kernel, {}, 2)
            slam.restore(data)
        slam.process(pack(sweep, "r1", "0" * 32, seq))
        slam.map()
        stands(slam.trajectory())
    slam.finish()
print(len(warm), sorted(loaded() - warm))
"""


@pytest.mark.parametrize("kernel", ["graph", "gmapping"])
def test_a_warm_worker_compiles_nothing_when_its_first_robot_comes_nor_when_one_is_restored(kernel: str) -> None:
    ran = subprocess.run([sys.executable, "-c", RUN, kernel], check=True, stdout=subprocess.PIPE, text=True)
    warm, more = ran.stdout.split(maxsplit=1)
    assert int(warm) > 5
    assert more.strip() == "[]"
