"""Verdicts by pair and map version."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from drawn_worlds import apartment, mapped, symmetric_hall

from common.fusion import pairs
from common.fusion.match import Match
from common.fusion.matchmap import MatchMap
from common.fusion.pairs import PairTable, all_pairs, complete
from common.fusion.survey import Place
from common.fusion.verdicts import measurements
from common.geometry import between


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


def strip(robots: int) -> tuple[dict[str, MatchMap], dict[str, Place]]:
    """Maps of robots one after the other along a building, and where they lie in one component."""
    world, names = apartment(3, width_m=6.0 * robots + 5.0), [f"r{k}" for k in range(robots)]
    maps = {name: mapped(world, frame_of(k), (6.0 * k, 6.0 * k + 11.0), seed=k) for k, name in enumerate(names)}
    return maps, {name: Place("r0", frame_of(k)) for k, name in enumerate(names)}


def frame_of(k: int) -> np.ndarray:
    return np.array([5.0 * k, 1.0, 0.5 * k])


def filled(maps: dict[str, MatchMap], final: bool = False) -> PairTable:
    made = PairTable()
    for name, map_ in maps.items():
        made.put(name, map_, 1, final)
    return made


def test_where_other_pairs_tell_how_maps_lie_nothing_is_searched() -> None:
    maps, placed = strip(5)
    made = filled(maps)
    made.decide(all_pairs(maps), placed)
    assert made.checks <= 2  # pairs much alike and yet apart
    kinds = {pair: verdict.kind for pair, verdict in made.verdicts.items()}
    assert [kinds[f"r{k}", f"r{k + 1}"] for k in range(4)] == ["merged"] * 4
    assert kinds["r0", "r3"] == "no_overlap"


def test_a_wrong_place_is_not_believed_but_searched_for() -> None:
    maps, placed = strip(2)
    made = filled(maps)
    made.decide(all_pairs(maps), placed | {"r1": Place("r0", (2.0, 7.0, 1.5))})
    assert made.checks == 1
    found = made.verdicts["r0", "r1"]
    assert found.kind == "merged"
    assert found.transform == pytest.approx(between(frame_of(0), frame_of(1)), abs=0.05)


def test_places_of_different_components_tell_nothing() -> None:
    maps, placed = strip(2)
    made = filled(maps)
    made.decide(all_pairs(maps), placed | {"r1": Place("r1", placed["r1"].pose)})
    assert made.checks == 1


def test_searches_that_others_made_of_the_same_final_maps_are_not_made_again() -> None:
    maps, _ = strip(4)
    made, again = filled(maps, final=True), filled(maps, final=True)
    made.decide(all_pairs(maps))
    again.decide(all_pairs(maps), told=made.verdicts.values())
    assert made.checks >= 3
    assert (again.verdicts, again.checks) == (made.verdicts, 0)
    for k in range(3):
        found = made.verdicts[f"r{k}", f"r{k + 1}"]
        assert found.transform == pytest.approx(between(frame_of(k), frame_of(k + 1)), abs=0.05)


def test_places_have_no_say_on_final_maps() -> None:
    maps, placed = strip(2)
    with_places, without = filled(maps, final=True), filled(maps, final=True)
    with_places.decide(all_pairs(maps), placed | {"r1": Place("r0", (2.0, 7.0, 1.5))})
    without.decide(all_pairs(maps))
    assert with_places.verdicts == without.verdicts
    assert with_places.checks == 1


def test_evidence_against_a_merge_undoes_it() -> None:
    maps, _ = strip(2)
    made = filled(maps)
    made.decide([("r0", "r1")])
    assert made.verdicts["r0", "r1"].kind == "merged"
    made.put("r1", mapped(apartment(31), frame_of(1), seed=1), 2, False)
    made.decide([("r0", "r1")])
    assert made.verdicts["r0", "r1"].kind != "merged"
    assert measurements(made.verdicts.values()) == {}


def test_start_poses_tell_which_way_a_symmetric_room_is_meant() -> None:
    frames = {"a": np.array([3.0, 2.0, 0.3]), "b": np.array([9.0, 5.0, 2.0])}
    made = filled({name: mapped(symmetric_hall(), frame, seed=k) for k, (name, frame) in enumerate(frames.items())})
    made.decide([("a", "b")])
    assert made.verdicts["a", "b"].kind == "ambiguous"
    rough = {name: frame + np.array([0.1, -0.1, 0.03]) * (-1) ** k for k, (name, frame) in enumerate(frames.items())}
    told = made.told_by_starts(made.verdicts.values(), rough)
    assert told["a", "b"].transform == pytest.approx(between(frames["a"], frames["b"]), abs=0.02)
    assert made.told_by_starts(made.verdicts.values(), {"a": frames["a"]}) == {}
