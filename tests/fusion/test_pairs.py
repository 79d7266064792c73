"""Verdicts by pair and map version."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.fusion import pairs
from common.fusion.match import Match
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, all_pairs, complete, measurements


def square(size: int) -> MatchMap:
    """A room of `size` cells with walls around."""
    cells = np.zeros((size, size), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
    return MatchMap.of(cells, (0, 0), 0.05)


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was done about pairs, in order: `match` finds nothing here, `track` what it is told."""
    done: list[str] = []

    def found(name: str, kind: str) -> Callable[..., Match]:
        def look(*_: object, **__: object) -> Match:
            done.append(name)
            transform = np.zeros(3) if kind == "merged" else None
            return Match(
                kind=kind, reason="", transform=transform, information=np.eye(3) if transform is not None else None
            )

        return look

    monkeypatch.setattr(pairs, "match", found("match", "merged"))
    monkeypatch.setattr(pairs, "track", found("track", "merged"))
    return done


def table(size: int = 40, final: bool = False) -> PairTable:
    made = PairTable()
    for robot in ("a", "b"):
        made.put(robot, square(size), 1, final)
    return made


def test_a_pair_is_decided_once_a_version(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "b")])
    made.decide([("a", "b")])
    assert looks == ["match"]


def test_a_merged_pair_is_tracked(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "b")])
    made.put("a", square(40), 2, False)
    made.decide([("a", "b")])
    assert looks == ["match", "track"]
    assert made.verdicts["a", "b"].versions == (2, 1)


def test_a_final_verdict_is_made_from_nothing_but_the_maps(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "b")])
    for robot in ("a", "b"):
        made.put(robot, square(40), 1, True)
    made.decide([("a", "b")])
    assert looks == ["match", "match"]
    assert made.verdicts["a", "b"].final


def test_pairs_of_unknown_robots_are_passed_over(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "z")])
    assert looks == []


def test_a_forgotten_robot_takes_its_verdicts_along(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "b")])
    made.forget("b")
    assert (made.verdicts, made.sizes) == ({}, {})


def test_an_undecided_pair_is_looked_at_again_only_when_a_map_has_grown(monkeypatch: pytest.MonkeyPatch) -> None:
    made = PairTable()
    for robot in ("a", "b"):
        made.put(robot, MatchMap.of(np.full((1, 1), -1, np.int8), (0, 0), 0.05), 1, False)
    made.decide([("a", "b")])
    assert (made.verdicts["a", "b"].kind, made.checks) == ("insufficient", 1)
    made.put("a", MatchMap.of(np.full((1, 1), -1, np.int8), (0, 0), 0.05), 2, False)
    made.decide([("a", "b")])
    assert (made.verdicts["a", "b"].versions, made.checks) == ((2, 1), 1)
    made.put("a", square(40), 3, False)
    made.decide([("a", "b")])
    assert made.checks == 2


def test_completeness_asks_for_final_verdicts_of_exactly_these_versions(looks: list[str]) -> None:
    made = table(final=True)
    made.decide([("a", "b")])
    assert complete(made.verdicts, [("a", "b")], {"a": 1, "b": 1})
    assert not complete(made.verdicts, [("a", "b")], {"a": 1, "b": 2})
    assert not complete({}, [("a", "b")], {"a": 1, "b": 1})
    assert complete({}, [], {})


def test_only_merged_pairs_measure_anything(looks: list[str]) -> None:
    made = table()
    made.decide([("a", "b")])
    verdict = made.verdicts["a", "b"]
    assert set(measurements([verdict])) == {("a", "b")}
    assert measurements([verdict.model_copy(update={"transform": None})]) == {}


def test_pairs_come_in_sorted_order() -> None:
    assert all_pairs(["c", "a", "b"]) == [("a", "b"), ("a", "c"), ("b", "c")]
