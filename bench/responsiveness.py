"""How soon `scheduler/status` answers while a plan for very many robots is being made.

The scheduler runs here as in a cluster, its planner in a worker process, router and asker in processes of their own;
robots and edges are put into its state directly.
"""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any

from bench.synthetic_cluster import SyntheticCluster
from common.bus import Bus, keys
from common.config import SchedulerConfig
from common.parent import Leash
from common.presence import RobotSeen
from common.service import forget_start
from services.scheduler.events import EdgeSeen, Interval, MakePlan, Profiled, Tick
from services.scheduler.service import Scheduler

ROUTER = """
import asyncio, sys
from common.bus import Router
async def main():
    async with await Router.open() as router:
        print(router.endpoint, flush=True)
        await asyncio.to_thread(sys.stdin.read)
asyncio.run(main())
"""
WARM = 5
"""first answers that do not count: connections are being made"""


async def responsiveness(robots: int, edges: int, policy: str, plans: int = 3) -> dict[str, Any]:
    """Latencies of status queries, asked every 10 ms from another process during so many plans."""
    router = await asyncio.create_subprocess_exec(
        sys.executable, "-c", ROUTER, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    assert router.stdout is not None
    endpoint = (await router.stdout.readline()).decode().strip()
    fleet = SyntheticCluster(robots, edges, policy=policy).fleet.model_copy(
        update={"scheduler": SchedulerConfig(policy=policy, interval_s=600)}
    )
    stop = asyncio.Event()
    forget_start()
    try:
        async with await Bus.open(endpoint, name="scheduler", role="scheduler") as bus:
            scheduler = Scheduler(fleet, bus, stop)
            running = asyncio.create_task(scheduler.run())
            await asyncio.sleep(2)
            _populate(scheduler, robots, edges, policy)
            await asyncio.sleep(3.5)
            with Leash() as leash:
                asker = await asyncio.create_subprocess_exec(
                    sys.executable, "-m", "bench.responsiveness", endpoint,
                    stdout=asyncio.subprocess.PIPE, stdin=asyncio.subprocess.PIPE,
                    pass_fds=leash.pass_fds,
                )  # fmt: skip
                assert asker.stdout is not None
                await asker.stdout.readline()
                seconds = [await _one_plan(scheduler) for _ in range(plans)]
                said, _ = await asker.communicate(b"\n")
            stop.set()
            await running
    finally:
        router.kill()
        await router.wait()
    waits = sorted(map(float, said.split()))
    return {
        "policy": policy,
        "robots": robots,
        "edges": edges,
        "plan s": sum(seconds) / plans,
        "answers": len(waits),
        "median ms": 1e3 * waits[len(waits) // 2],
        "99 % ms": 1e3 * waits[int(0.99 * (len(waits) - 1))],
        "worst ms": 1e3 * waits[-1],
    }


def _populate(scheduler: Scheduler, robots: int, edges: int, policy: str) -> None:
    """Everybody is there and has been measured; tables on the way are not published."""
    model, now = SyntheticCluster(robots, edges, policy=policy, noise=0.1), asyncio.get_running_loop().time()
    model.start()
    model.report()
    model.inputs.notices.clear()  # nobody is there to be asked for sketches
    scheduler._inputs = model.inputs
    state = scheduler.state
    for edge in model.edge_names:
        state.handle(EdgeSeen(edge, True, now))
    for robot in model.robot_names:
        state.handle(Profiled(model.state.profiles[robot], now))
        state.handle(RobotSeen(robot, True, now))
    state.handle(Tick(now))


async def _one_plan(scheduler: Scheduler) -> float:
    begin = time.monotonic()
    steps = scheduler.state.handle(Interval(asyncio.get_running_loop().time()))
    assert len(steps) == 1, "nothing to plan for"
    assert isinstance(steps[0], MakePlan)
    await scheduler._plan(steps[0])
    return time.monotonic() - begin


async def _ask(endpoint: str) -> None:
    """Ask until a line comes in; print each wait in seconds."""
    ended = asyncio.create_task(asyncio.to_thread(sys.stdin.readline))
    async with await Bus.open(endpoint, name="asker", role="command") as bus:
        waits = []
        print("asking", flush=True)
        while not ended.done():
            begin = time.perf_counter()
            if await bus.get(keys.SCHEDULER_STATUS):
                waits.append(time.perf_counter() - begin)
            await asyncio.sleep(0.01)
    print("\n".join(map(str, waits[WARM:])))


if __name__ == "__main__":
    asyncio.run(_ask(sys.argv[1]))
