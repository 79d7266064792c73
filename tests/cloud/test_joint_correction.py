"""Joint correction asks for trajectories of exactly the maps that were solved; without them the rigid world stands."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any, cast

import numpy as np
import pytest

from common.bus import Bus
from common.errors import QueryFailed
from common.wire import FixedPose, Message, Placed, TrajectoryPage, Transforms, encode
from services.cloud_merger.joint import TRIES, corrected

EDGES = {"r1": "e1", "r2": "e2", "r3": "e1"}
VERSION = 7


class Edges:
    """Trajectories as edges show them, of this map version; an edge that is gone does not answer so many times."""

    def __init__(self, version: int = VERSION, gone: str = "", times: int = TRIES) -> None:
        self.version, self.gone, self.times, self.asked = version, gone, times, list[str]()

    async def pages(self, key: str, params: Mapping[str, str] = {}) -> AsyncIterator[Message]:
        self.asked.append(key)
        if self.gone and self.gone in key and self.times:
            self.times -= 1
            raise QueryFailed("nobody answers; is its owner up?", key)
        for start, following in ((0, 2), (2, None)):
            rows = np.arange(4.0 * start, 4.0 * (start + 2)).reshape(2, 4)
            yield TrajectoryPage(robot=key.split("/")[3], version=self.version, poses=rows, next=following)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.cloud_merger.joint.RETRY_S", 0.0)


def solved() -> dict[str, Any]:
    pose = FixedPose(x_um=0, y_um=0, theta_nrad=0)
    robots = {robot: Placed(transform=pose, component=robot, version=VERSION) for robot in EDGES}
    world = Transforms(world_epoch=1, final=True, resolution=0.05, robots=robots, components=())
    return {"transforms": encode(world), "merged": [("r1", "r2")], "seconds": 1.0}


async def run(edges: Edges, members: Mapping[str, str] = EDGES) -> tuple[dict[str, Any], list[Any], list[str]]:
    calls, problems = list[Any](), list[str]()

    async def call(method: str, **arguments: Any) -> dict[str, Any]:
        calls.append((method, arguments))
        return {"transforms": b"corrected", "seconds": 0.5}

    done = await corrected(solved(), members, cast(Bus, edges), call, problems.append)
    return done, calls, problems


async def test_the_merged_robots_whole_trajectories_go_into_the_correction() -> None:
    edges = Edges()
    done, [(method, arguments)], problems = await run(edges)
    assert edges.asked == ["edge/e1/robot/r1/trajectory", "edge/e2/robot/r2/trajectory"]
    assert method == "correct"
    assert arguments["pairs"] == [("r1", "r2")]
    rows = np.frombuffer(arguments["tracks"]["r2"]).reshape(-1, 4)
    assert np.array_equal(rows, np.arange(16.0).reshape(4, 4))
    assert (done["transforms"], done["seconds"], problems) == (b"corrected", 1.5, [])


async def test_an_edge_that_does_not_answer_for_a_moment_is_asked_again() -> None:
    done, calls, problems = await run(Edges(gone="e2", times=TRIES - 1))
    assert (done["transforms"], len(calls), problems) == (b"corrected", 1, [])


@pytest.mark.parametrize(
    ("edges", "members", "reason"),
    [
        (Edges(gone="e2"), EDGES, "nobody answers"),
        (Edges(version=VERSION + 1), EDGES, "map has changed"),
        (Edges(), {"r1": "e1"}, "has left"),
    ],
    ids=["an edge is gone", "a map is newer", "a robot has left"],
)
async def test_the_rigid_world_stands_and_the_reason_is_told_when(
    edges: Edges, members: Mapping[str, str], reason: str
) -> None:
    done, calls, problems = await run(edges, members)
    assert done == solved()
    assert calls == []
    assert "rigid transforms stay" in problems[0]
    assert reason in problems[0]
