from __future__ import annotations

import inspect

import pytest

from common.bus import keys
from common.errors import UsageError

FUNCTIONS = {
    name: function
    for name, function in inspect.getmembers(keys, inspect.isfunction)
    if function.__module__ == keys.__name__
    and not name.startswith("_")
    and name not in {"owner", "robot_of", "edge_of"}
}
CONSTANTS = [value for name, value in vars(keys).items() if name.startswith(("CLOUD_", "SCHEDULER_"))]


def make(name: str, robot: str, edge: str) -> str:
    function = FUNCTIONS[name]
    return function(**{k: {"robot": robot, "edge": edge}[k] for k in inspect.signature(function).parameters})


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_key_tells_whose_it_is_and_what_it_is_about(name: str) -> None:
    key = make(name, "r1", "e1")
    asks = inspect.signature(FUNCTIONS[name]).parameters
    tier = name.split("_")[0]
    assert keys.owner(key) == (tier, {"robot": "r1", "edge": "e1", "cloud": ""}[tier])
    assert keys.robot_of(key) == ("r1" if "robot" in asks else None)
    assert keys.edge_of(key) == ("e1" if "edge" in asks else None)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_star_makes_the_wildcard_form_and_nothing_else_does(name: str) -> None:
    assert "*" in make(name, "*", "*")
    for bad in ("", "a/b", "**", "a b", "x" * 65, "é", "a?b", "r1\n"):
        with pytest.raises(UsageError, match="is no name"):
            make(name, bad, bad)


def test_keys_without_names_belong_to_cloud_and_scheduler() -> None:
    assert {keys.owner(key) for key in CONSTANTS} == {("cloud", ""), ("scheduler", "")}
    assert {keys.robot_of(key) for key in CONSTANTS} == {keys.edge_of(key) for key in CONSTANTS} == {None}


def test_no_two_keys_are_alike() -> None:
    every = [make(name, "r1", "e1") for name in FUNCTIONS] + CONSTANTS
    assert len(set(every)) == len(every)


@pytest.mark.parametrize("key", ["", "robot", "robot/r1", "edge/e1", "cloud", "somebody/else/map"])
def test_a_foreign_key_has_no_owner(key: str) -> None:
    with pytest.raises(UsageError, match="no key of this system"):
        keys.owner(key)
