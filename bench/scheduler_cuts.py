"""Cuts of equal groups by our methods and by others', over the least cut known of each graph.

The least cuts known come from long runs and are kept in best_cuts.json; whatever finds a smaller one lowers it there.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.results import show
from bench.scheduler_graphs import FAMILIES, graph
from bench.scheduler_peers import kernighan_lin, metis
from bench.scheduler_times import KAPPA, TAU
from services.scheduler.baselines import greedy_grouping, random_balanced_grouping
from services.scheduler.cut import least_cut
from services.scheduler.graph import Groups, Weights, cut
from services.scheduler.grouping import balanced_grouping, initial_grouping

KEPT = Path(__file__).with_name("best_cuts.json")
SIZES = ((10, 3), (20, 4), (50, 5), (200, 20), (1000, 50))
"""robots, edges"""
BUDGET_S = {10: 0.09, 20: 0.09, 50: 0.09, 200: 0.45, 1000: 4.5}
"""CPU seconds of policy `cut`, a tenth below its limit, as the search looks at the clock now and then"""
LONG_S = {10: 0.1, 20: 0.5, 50: 1.0, 200: 10.0, 1000: 30.0}
SLIGHT = 1e-3
"""share of all overlap that is added to both cuts of a ratio, as the least one may be 0"""
Grouping = Callable[[Weights, int], Groups]


def timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    begin = time.process_time()
    return work(*arguments), time.process_time() - begin


def within(budget_s: float, seed: int = 0) -> Grouping:
    """Policy `cut` with this budget."""

    def search(weights: Weights, count: int) -> Groups:
        begin, rng = time.process_time(), np.random.default_rng(seed)
        return least_cut(weights, count, rng, lambda: (time.process_time() - begin) / budget_s).groups

    return search


def methods(robots: int) -> dict[str, Grouping]:
    found: dict[str, Grouping] = {
        "random-balanced": lambda w, n: random_balanced_grouping(len(w), n, np.random.default_rng(0)),
        "greedy": lambda w, n: greedy_grouping(w, n, np.random.default_rng(0)),
        "algorithm 1": initial_grouping,
        "paper": lambda w, n: balanced_grouping(w, n, KAPPA, TAU),
        "paper-printed": lambda w, n: balanced_grouping(w, n, KAPPA, TAU, "printed"),
        "paper, long": lambda w, n: balanced_grouping(w, n, 10 * KAPPA, len(w)),
        "metis": metis,
        "cut": within(BUDGET_S.get(robots, 0.1)),
    }
    if robots <= 50:
        found["kernighan-lin"] = kernighan_lin
    return found


def long_cuts(quick: bool) -> list[dict[str, Any]]:
    """Long searches for the least cuts; smaller ones than known are kept."""
    known = _known()
    for robots, edges, family, seed in _graphs(quick):
        weights = graph(family, robots, seed)
        found = cut(weights, within(LONG_S[robots], 1)(weights, edges))
        _keep(known, _name(family, robots, edges, seed), found)
    return [{"graph": name, "cut": least} for name, least in known.items()]


def cuts(quick: bool) -> list[dict[str, Any]]:
    """Medians over graphs of a family: each method's cut over the least known and over all overlap, and its time."""
    known, rows = _known(), []
    for (robots, edges, family), graphs in itertools.groupby(_graphs(quick), lambda each: each[:3]):
        ratios: dict[str, list[float]] = {}
        shares: dict[str, list[float]] = {}
        seconds: dict[str, list[float]] = {}
        for *_, seed in graphs:
            weights, name = graph(family, robots, seed), _name(family, robots, edges, seed)
            found = {method: timed(search, weights, edges) for method, search in methods(robots).items()}
            values = {method: cut(weights, groups) for method, (groups, _) in found.items()}
            best, total = _keep(known, name, min(values.values())), float(weights.sum()) / 2
            for method, value in values.items():
                ratios.setdefault(method, []).append((value + SLIGHT * total) / (best + SLIGHT * total))
                shares.setdefault(method, []).append(value / total)
                seconds.setdefault(method, []).append(found[method][1])
        for method in ratios:
            rows.append(
                {
                    "family": family,
                    "robots": robots,
                    "edges": edges,
                    "method": method,
                    "over_best": float(np.median(ratios[method])),
                    "worst": float(max(ratios[method])),
                    "over_total": float(np.median(shares[method])),
                    "cpu_ms": 1e3 * float(np.median(seconds[method])),
                }
            )
        show(rows[-len(ratios) :])
    return rows


def _graphs(quick: bool) -> Iterator[tuple[int, int, str, int]]:
    """(robots, edges, family, seed)"""
    for (robots, edges), family in itertools.product(SIZES[:3] if quick else SIZES, FAMILIES):
        for seed in range(3 if quick or robots > 50 else 8):
            yield robots, edges, family, seed


def _name(family: str, robots: int, edges: int, seed: int) -> str:
    return f"{family} {robots} {edges} {seed}"


def _known() -> dict[str, float]:
    return json.loads(KEPT.read_text()) if KEPT.is_file() else {}


def _keep(known: dict[str, float], name: str, found: float) -> float:
    """The least cut known of this graph, this one included."""
    if found < known.get(name, np.inf):
        known[name] = found
        KEPT.write_text(json.dumps(known, indent=1) + "\n")
    return known[name]
