"""Which pairs of a fleet are searched: as many as there are overlaps, not as many as there are pairs.

Searching a pair is dear. So the most alike are searched first, and only until they hang together; where links tell how
two other maps lie, the pair is judged there, and searched only when something speaks against that place, or when the
two are much alike and yet are said to share nothing. Robots that nothing joins get a few searches each. When links
contradict each other around a cycle, the worst is set aside and the fleet is surveyed again without it.

What comes out depends on nothing but the pairs' searches and likenesses, taken in sorted order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol

from networkx.utils import UnionFind
from numpy.typing import ArrayLike

from common.fusion.cycles import Measurement, Pair, contradicted
from common.fusion.likeness import SIGNIFICANT
from common.fusion.settings import FusionSettings
from common.fusion.solve import solve
from common.fusion.verdicts import measurements
from common.geometry.se2 import Pose, between
from common.wire.edge import PairVerdict

TRIES = 3
"""searches that a robot gets although it is hardly like anything"""

Predict = Callable[[str, str], Pose | None]


class Place(NamedTuple):
    """Where a robot's map was found to lie."""

    component: str
    pose: ArrayLike
    """(3,) of the map's frame in the component's, or in the world"""


class Looks(Protocol):
    """Ways to look at a pair, from cheap to dear."""

    def likeness(self, pair: Pair) -> int: ...

    def pass_over(self, pair: Pair) -> PairVerdict:
        """The verdict on a pair that is not worth a search."""

    def verify(self, pair: Pair, pose: Pose) -> PairVerdict | None:
        """The verdict on the pair where others put it; None when it must be searched."""

    def search(self, pair: Pair) -> PairVerdict: ...


def survey(
    pairs: Iterable[Pair],
    looks: Looks,
    settings: FusionSettings,
    *,
    kept: Mapping[Pair, PairVerdict] = {},
    told: Mapping[Pair, PairVerdict] = {},
    placed: Mapping[str, Place] = {},
) -> dict[Pair, PairVerdict]:
    """A verdict on each of the pairs. `kept` are earlier searches that still hold, `told` verdicts of others on other
    pairs, `placed` where robots were found to lie before."""
    wanted = sorted(pairs)
    robots = sorted({robot for pair in [*wanted, *told] for robot in pair})
    found = {**told, **kept}
    set_aside: set[Pair] = set()
    while True:
        links = _join(wanted, found, set_aside, placed, looks)
        judged = _explain(wanted, found, set_aside, _prediction(robots, links, placed), looks)
        refuted = set(contradicted(measurements([*found.values(), *judged.values()]), settings)) - set_aside
        if not refuted:
            return {pair: found[pair] if pair in found else judged[pair] for pair in wanted}
        set_aside |= refuted


def _join(
    wanted: list[Pair],
    found: dict[Pair, PairVerdict],
    set_aside: set[Pair],
    placed: Mapping[str, Place],
    looks: Looks,
) -> dict[Pair, Measurement]:
    """Search the most alike until all hangs together or is tried enough; gives the links there are then."""
    links = {pair: link for pair, link in measurements(found.values()).items() if pair not in set_aside}
    groups = UnionFind([robot for pair in wanted for robot in pair])
    for a, b in links:
        groups.union(a, b)
    for name, place in placed.items():
        groups.union(name, ("component", place.component))
    tries = Counter(robot for pair, verdict in found.items() if verdict.kind != "merged" for robot in pair)
    apart = [pair for pair in wanted if pair not in found and groups[pair[0]] != groups[pair[1]]]
    alike = {pair: looks.likeness(pair) for pair in apart}
    for pair in sorted(apart, key=lambda pair: (-alike[pair], pair)):
        a, b = pair
        if groups[a] == groups[b] or (alike[pair] < SIGNIFICANT and min(tries[a], tries[b]) >= TRIES):
            continue
        found[pair] = looks.search(pair)
        if found[pair].kind == "merged":
            links |= measurements([found[pair]])
            groups.union(a, b)
        else:
            tries.update(pair)
    return links


def _explain(
    wanted: list[Pair],
    found: dict[Pair, PairVerdict],
    set_aside: set[Pair],
    predict: Predict,
    looks: Looks,
) -> dict[Pair, PairVerdict]:
    """Verdicts on the pairs that were not searched, by what is known of the others; searches what that leaves open."""
    judged: dict[Pair, PairVerdict] = {}
    for pair in wanted:
        if pair in found:
            continue
        pose = predict(*pair)
        verdict = looks.pass_over(pair) if pose is None else None
        if pose is not None and pair not in set_aside:
            verdict = looks.verify(pair, pose)
        if verdict is None:
            found[pair] = looks.search(pair)
        else:
            judged[pair] = verdict
    return judged


def _prediction(robots: list[str], links: Mapping[Pair, Measurement], placed: Mapping[str, Place]) -> Predict:
    """Where links, or else earlier places, put the second of two robots in the first's frame."""
    homes = {name: (each.id, each.transforms[name]) for each in solve(robots, links) for name in each.robots}

    def predict(a: str, b: str) -> Pose | None:
        for known in (homes, placed):
            if a in known and b in known and known[a][0] == known[b][0]:
                return between(known[a][1], known[b][1])
        return None

    return predict
