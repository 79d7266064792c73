"""What is different from before, in words: every move of walls is declared, un-merges first of all.

A new world moves robot maps as wholes; SLAM moves what is within one, and then the world need not change.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from common.wire import Covers, Placed

STEADY_M, STEADY_RAD = 0.02, 0.002
"""live transforms that move less than this stay as published: the frame does not tremble"""


def reason(placed: Mapping[str, Placed], old: Mapping[str, Placed] | None, was_final: bool, final: bool) -> str:
    """Why there is a new world epoch; empty: nothing worth one has changed."""
    if old is None:
        return "first maps"
    told = [f"un-merged: {' and '.join(group)} from {first}" for first, group in parted(placed, old)]
    if final:
        return "; ".join(["final: solved from the final maps alone", *told])
    if told:
        return "; ".join(told)
    if was_final:
        return "maps have changed since the final world"
    for name in sorted(set(placed) | set(old)):
        if name not in placed or name not in old:
            return f"{name} has {'come' if name in placed else 'gone'}"
        if placed[name].component != old[name].component:
            return f"{name} is now in the component of {placed[name].component}"
    return _correction(placed, old)


def parted(placed: Mapping[str, Placed], old: Mapping[str, Placed]) -> list[tuple[str, tuple[str, ...]]]:
    """Un-merges: (a robot, robots that had been in its component and are in another now), in sorted order."""
    found = []
    staying = [name for name in sorted(old) if name in placed]
    for component in sorted({old[name].component for name in staying}):
        groups: dict[str, list[str]] = {}
        for name in staying:
            if old[name].component == component:
                groups.setdefault(placed[name].component, []).append(name)
        first, *others = groups.values()
        found += [(first[0], tuple(group)) for group in others]
    return found


def changed(covers: Covers, before: Covers) -> tuple[str, ...]:
    """What has changed in robot maps from one version of the global map to another, beside that they have grown."""
    told = [f"the map of {name} is in it" for name in sorted(covers.keys() - before.keys())]
    told += [f"the map of {name} is not in it any more" for name in sorted(before.keys() - covers.keys())]
    for name in sorted(covers.keys() & before.keys()):
        now, old = covers[name], before[name]
        if (now.stream, now.epoch) != (old.stream, old.epoch) or now.corrections < old.corrections:
            told.append(f"the map of {name} was made anew")
        elif now.corrections > old.corrections:
            more = f", the last of {now.corrections - old.corrections}" if now.corrections > old.corrections + 1 else ""
            told.append(f"SLAM corrected the map of {name} by up to {now.corrected_m:.3f} m{more}")
    return tuple(told)


def _correction(placed: Mapping[str, Placed], old: Mapping[str, Placed]) -> str:
    """Robots that have moved more than trembling, the one that moved farthest told in figures."""
    steps = {name: np.subtract(each.transform.pose(), old[name].transform.pose()) for name, each in placed.items()}
    moved = [name for name, s in sorted(steps.items()) if np.hypot(s[0], s[1]) > STEADY_M or abs(s[2]) > STEADY_RAD]
    if not moved:
        return ""
    worst = max(moved, key=lambda name: float(np.hypot(*steps[name][:2])))
    metres, degrees = np.hypot(*steps[worst][:2]), abs(np.degrees(steps[worst][2]))
    others = f" and {len(moved) - 1} others" if len(moved) > 1 else ""
    return f"correction: {worst} by {metres:.3f} m and {degrees:.2f} deg{others}"
