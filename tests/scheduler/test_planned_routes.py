"""Planning before any map exists: from routes and start poses."""

from __future__ import annotations

import json

import pytest

from common.errors import BadFile
from services.scheduler.offline import plan_routes
from services.scheduler.routes_file import coverage, read_routes

TOML = """
reach = 3.0
[robots]
r1 = [[0, 0], [8, 0]]
r2 = [[50, 0], [50, 8]]
r3 = { way = [[1, 1]], reach = 5.0 }
r4 = [[52, 1]]
"""


def test_robots_whose_routes_will_see_the_same_are_grouped(tmp_path) -> None:
    (tmp_path / "routes.toml").write_text(TOML)
    plan = plan_routes(tmp_path / "routes.toml", 2, "recslam", 0.3)
    named = {frozenset(plan.robots[index] for index in group) for group in plan.groups}
    assert named == {frozenset({"r1", "r3"}), frozenset({"r2", "r4"})}
    assert plan.cut == 0
    assert min(plan.in_group) > 0


def test_json_says_the_same_as_toml_and_overlaps_come_from_routes(tmp_path) -> None:
    robots = {"r1": [[0, 0], [8, 0]], "r2": [[50, 0], [50, 8]], "r3": {"way": [[1, 1]], "reach": 5.0}, "r4": [[52, 1]]}
    (tmp_path / "routes.json").write_text(json.dumps({"reach": 3.0, "robots": robots}))
    (tmp_path / "routes.toml").write_text(TOML)
    one, two = (coverage(read_routes(tmp_path / f"routes.{kind}")).overlap for kind in ("json", "toml"))
    assert (one.weights == two.weights).all()
    assert one.sources() == {"route": 6}


@pytest.mark.parametrize(
    "text", ["robots = 3", "[robots]\nr1 = []", "[robots]\nr1 = [[0]]", "reach = -1\n[robots]\n", "["]
)
def test_a_file_that_holds_no_routes_is_refused_by_name(tmp_path, text: str) -> None:
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(BadFile, match=r"wrong\.toml"):
        read_routes(tmp_path / "wrong.toml")
