"""Services die in the middle of a run: the final map is that of an undisturbed one."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest
from harness import Cluster, all_gone, children, cluster, fleet

from common.bus import keys
from common.wire import Ack, EdgeStatus, GlobalMapNotice, RobotStatus
from common.wire.edge import VANISHED

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(240)]

SOME = 40
"""frames after which a run is in its middle"""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> GlobalMapNotice:
    """The final map of a single edge, without any trouble."""
    return asyncio.run(without_trouble(tmp_path_factory.mktemp("undisturbed")))


async def without_trouble(folder: Path) -> GlobalMapNotice:
    async with cluster(fleet(count=1, topology="single-edge"), folder) as made:
        await made.start_all()
        final = await made.final()
        pids = {pid for process in made.processes.values() for pid in children(process.pid)}
        assert pids
        assert set(await made.stop()) == {0}
        assert await all_gone(pids)
        assert made.faults() == []
    return final


async def finish(made: Cluster, undisturbed: GlobalMapNotice) -> None:
    final = await made.final()
    assert final.covers.keys() == undisturbed.covers.keys()
    assert {robot: each.seq for robot, each in final.covers.items()} == {
        robot: each.seq for robot, each in undisturbed.covers.items()
    }
    assert final.digest == undisturbed.digest
    assert made.faults() == []


async def test_a_killed_slam_worker_and_a_killed_edge_leave_no_trace_in_the_map(
    tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    async with cluster(fleet(), tmp_path) as made:
        await made.start_all()
        edge = await made.processed("r1", SOME)
        workers = computing(made.processes[edge].pid, what="SlamHost")
        assert len(workers) > 1
        os.kill(sorted(workers)[1], signal.SIGKILL)  # the first is the template of the others
        other = await made.processed("r2", SOME)
        pids = children(made.processes[other].pid)
        await made.kill(other)
        assert await all_gone(pids)
        await finish(made, undisturbed)


async def test_everything_that_can_be_started_again_dies_and_the_run_completes(
    tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    async with cluster(fleet(), tmp_path) as made:
        await made.start_all()
        before = await made.processed("r1", SOME)
        edges = [made.processes[edge].pid for edge in made.fleet.edge_ids()]
        for pid in computing(made.processes["cloud"].pid, *edges):
            os.kill(pid, signal.SIGKILL)
        await made.processed("r2", SOME)
        earlier = await made.scheduler_status(lambda _: True)
        await made.kill("cloud")
        await made.kill("scheduler")
        await made.start("cloud", "scheduler")
        await finish(made, undisturbed)
        assert await made.processed("r1", SOME) == before
        status = await made.scheduler_status(lambda _: True)
        assert status.epoch[0] > earlier.epoch[0]
        assert {process.returncode for process in made.processes.values()} == {None}


async def test_robots_are_heard_again_when_the_scheduler_and_all_edges_have_been_started_anew(
    tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    """Nobody but the robots is left then who knows of the tables before."""
    async with cluster(fleet(), tmp_path) as made:
        await made.start_all()
        first = await made.processed("r1", SOME)
        await made.kill(first)  # robots move: one table more than the next scheduler begins with
        await made.hear(keys.edge_ack(keys.ANY, "r1"), Ack, lambda ack: ack.edge != first and ack.processed >= 0)
        for name in ("scheduler", *(edge for edge in made.fleet.edge_ids() if edge != first)):
            await made.kill(name)
        await made.start("scheduler", *made.fleet.edge_ids())
        await finish(made, undisturbed)


async def test_robots_with_an_edge_each_and_no_preparative_fusion_give_the_same_map(
    tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    source = fleet()
    robots = tuple(robot.model_copy(update={"edges": (f"edge-{robot.id}",)}) for robot in source.robots)
    edges = tuple({"id": f"edge-{robot.id}"} for robot in source.robots)
    async with cluster(fleet(topology="cloud", robots=robots, edges=edges), tmp_path) as made:
        await made.start_all()
        await finish(made, undisturbed)


@pytest.mark.parametrize("how", ["killed", "frozen"])
async def test_a_robot_that_is_gone_for_good_is_not_waited_for_and_one_that_comes_back_is_in_the_map_wholly(
    how: str, tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    edge = {"workers": 1, "map_every_s": 0.5, "lease_s": 3.0, "window": 8}
    async with cluster(fleet(edge=edge), tmp_path) as made:
        await made.start_all()
        home = await made.processed("r2", SOME)
        robot = made.processes["r2"]
        if how == "killed":
            await made.kill("r2")
        else:
            robot.send_signal(signal.SIGSTOP)
        final = await made.final()
        last, whole = final.covers["r2"].seq, undisturbed.covers["r2"].seq
        assert SOME <= last < whole
        assert final.covers["r1"].seq == undisturbed.covers["r1"].seq

        def vanished(status: EdgeStatus) -> bool:
            return ("r2", VANISHED, last) in [(each.robot, each.state, each.processed) for each in status.instances]

        status = await made.edge_status(home, vanished)
        assert any(f"robot/r2: vanished at frame {last}" in problem for problem in status.problems)
        if how == "killed":
            await made.start("r2")
        else:
            robot.send_signal(signal.SIGCONT)
        back = await made.hear(keys.CLOUD_MAP, GlobalMapNotice, lambda n: n.final and n.covers["r2"].seq == whole)
        assert back.world_epoch > final.world_epoch
        assert back.digest == undisturbed.digest
        assert made.faults() == []


async def test_robots_forget_what_is_in_a_checkpoint_and_an_edge_that_dies_then_leaves_no_trace_in_the_map(
    tmp_path: Path, undisturbed: GlobalMapNotice
) -> None:
    edge = {"workers": 1, "map_every_s": 0.5, "window": 8}
    edge |= {"checkpoints": str(tmp_path / "checkpoints"), "checkpoint_frames": 20}
    async with cluster(fleet(edge=edge), tmp_path) as made:
        await made.start_all()
        home = await made.processed("r1", SOME)

        def trimmed(status: RobotStatus) -> bool:
            return status.spooled < status.sent

        await made.hear(keys.robot_status("r1"), RobotStatus, trimmed)
        await made.kill(home)
        (other,) = {*made.fleet.edge_ids()} - {home}

        def all_there(status: EdgeStatus) -> bool:
            return [(each.robot, each.state) for each in status.instances] == [("r1", "final"), ("r2", "final")]

        # the run may have been over when the edge died: only once the other one has both robots has it gone on
        status = await made.edge_status(other, all_there)
        assert [each.gaps for each in status.instances] == [0, 0]
        await finish(made, undisturbed)


def computing(*pids: int, what: str = "Host") -> set[int]:
    """Worker processes of these services whose class has a name like `what`."""
    workers = {child for pid in pids for child in children(pid)}
    return {pid for pid in workers if what in Path(f"/proc/{pid}/cmdline").read_text()}
