"""Algorithms 1 and 2 line by line with Python's sets and lists, to compare the compiled ones with."""

from __future__ import annotations

import numpy as np


def fitness(weights, groups) -> float:
    count = len(groups)
    return sum(weights[u, v] for u in range(count) for v in range(u) if groups[u] != groups[v])


def algorithm_1(weights, n: int) -> np.ndarray:
    """Lines 1-26."""
    count = len(weights)
    c, r = set(range(count)), set()
    p = [set() for _ in range(n)]

    def neighbours(v):
        return {u for u in c if u != v and weights[u, v] > 0}

    def gain(v, i):
        return sum(weights[u, v] for u in p[i]) - sum(weights[u, v] for u in c - {v})

    flag = n == 1 or not c
    while not flag:
        seeding = not r
        for i in range(n - 1):
            if seeding:
                v = min(sorted(c), key=lambda x: len(neighbours(x)))
            else:
                v = max(sorted(c), key=lambda x: gain(x, i))
            p[i] |= {v}
            c -= {v}
            r = (r | (c & neighbours(v))) - {v}
            if len(c) <= count / n:
                flag = True
                break
    p[n - 1] |= c
    return np.array([next(i for i in range(n) if v in p[i]) for v in range(count)], dtype=np.int64)


def algorithm_2(weights, groups, kappa: int, tau: int, mode: str) -> np.ndarray:
    """Printed: all κ iterations are made, T is kept and forbids nothing. Intended: pairs in T need the amnesty."""
    t: list[frozenset[int]] = []
    best = list(groups)
    current = list(groups)
    for _ in range(kappa):
        s, g = [], []
        for v in range(len(groups)):
            for u in range(len(groups)):
                if current[v] != current[u]:
                    swapped = list(current)
                    swapped[v], swapped[u] = swapped[u], swapped[v]
                    allowed = mode == "printed" or frozenset((v, u)) not in t
                    if allowed or fitness(weights, swapped) < fitness(weights, best):
                        s.append(frozenset((v, u)))
                        g.append(swapped)
        if not g:
            break
        k = min(range(len(g)), key=lambda i: fitness(weights, g[i]))
        if fitness(weights, g[k]) < fitness(weights, best):
            if s[k] in t:
                t.remove(s[k])
            best = g[k]
        if s[k] not in t:
            t.append(s[k])
        if len(t) > tau:
            t.pop(0)
        current = g[k]
    return np.array(best, dtype=np.int64)


def algorithm_3(latencies) -> list[int]:
    """Latency of group i on edge j is `latencies[i][j]`."""
    edges = list(range(len(latencies)))
    theta = []
    for row in latencies:
        j = min(edges, key=lambda edge: row[edge])
        theta.append(j)
        edges.remove(j)
    return theta
