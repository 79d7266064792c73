"""Scan matching on a particle's endpoint map: how well a scan fits at a pose, and the climb to a better pose.

A beam's score falls with the square of the distance d from its end to the nearest centroid, 1 - (d/reach)^2, and is
nothing beyond `reach`: the middle of GMapping's exp(-d^2/sigma), which its 3 x 3 window cuts off likewise. `near`
holds that centroid for each cell, so a beam costs one look-up. Lengths are in cells ("table units", see patch_map).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from services.edge_worker.slam.gmapping.patch_pool import FAR_CELLS, LOW, NEAR_UNIT, SHIFT, SIDE


@njit(cache=True)
def rotate(points, theta, out):  # type: ignore[no-untyped-def]
    """Turn `points` (n, 2) by theta (rad) into `out`."""
    c, s = np.cos(theta), np.sin(theta)
    for row in range(len(points)):
        out[row, 0] = c * points[row, 0] - s * points[row, 1]
        out[row, 1] = s * points[row, 0] + c * points[row, 1]


@njit(cache=True)
def fit(turned, x, y, table, near, reach):  # type: ignore[no-untyped-def]
    """Sum of the beams' scores (0 to n) for endpoints `turned` (n, 2) shifted by (x, y)."""
    height, width = table.shape
    total = 0.0
    scale = 1.0 / (reach * reach)
    for row in range(len(turned)):
        u, v = turned[row, 0] + x, turned[row, 1] + y
        i, j = int(u), int(v)
        px, py = i >> SHIFT, j >> SHIFT
        if u >= 0.0 and v >= 0.0 and px < width and py < height:
            number, cell = table[py, px], (j & LOW) * SIDE + (i & LOW)
            dx, dy = near[number, cell, 0] * NEAR_UNIT - (u - i), near[number, cell, 1] * NEAR_UNIT - (v - j)
            total += max(0.0, 1.0 - (dx * dx + dy * dy) * scale)
    return total


@njit(cache=True)
def misfit(turned, x, y, table, near, spread, worst):  # type: ignore[no-untyped-def]
    """Negative log-likelihood: the sum of min(d^2 / spread^2 / 2, worst); and how many beams found a wall."""
    height, width = table.shape
    total, found = 0.0, 0
    scale = 0.5 / (spread * spread)
    for row in range(len(turned)):
        u, v = turned[row, 0] + x, turned[row, 1] + y
        cost = worst
        i, j = int(u), int(v)
        px, py = i >> SHIFT, j >> SHIFT
        if u >= 0.0 and v >= 0.0 and px < width and py < height:
            number, cell = table[py, px], (j & LOW) * SIDE + (i & LOW)
            dx, dy = near[number, cell, 0] * NEAR_UNIT - (u - i), near[number, cell, 1] * NEAR_UNIT - (v - j)
            if dx * dx + dy * dy < FAR_CELLS**2:  # else `near` says that there is no centroid
                found += 1
                cost = min(cost, (dx * dx + dy * dy) * scale)
        total += cost
    return total, found


@njit(cache=True)
def found_walls(points, pose, table, near):  # type: ignore[no-untyped-def]
    """How many of `points` (n, 2), base frame, have a centroid near at `pose` (3,); all in cells."""
    turned = np.empty((len(points), 2))
    rotate(points, pose[2], turned)
    return misfit(turned, pose[0], pose[1], table, near, 1.0, 0.0)[1]


@njit(cache=True)
def climb(points, start, guess, pull, step, turn, halvings, table, near, reach):  # type: ignore[no-untyped-def]
    """The pose near `start` where the scan fits best (GMapping's `optimize`): (x, y, theta, its score).

    points (n, 2) in the base frame and poses (x, y) in cells; `step` cells and `turn` rad are the first moves, halved
    each time that none of the six helps, `halvings` times. `pull` (2,) draws towards `guess`: score lost per squared
    cell and per squared radian. The four shifts of one heading share its turned points.
    """
    n = len(points)
    here, left, right = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
    x, y, theta = start[0], start[1], start[2]
    rotate(points, theta, here)
    best = fit(here, x, y, table, near, reach) - drawback(x, y, theta, guess, pull)
    turned = False
    for _ in range(halvings + 1):
        rotate(points, theta + turn, left)
        rotate(points, theta - turn, right)
        while True:
            if turned:
                rotate(points, theta + turn, left)
                rotate(points, theta - turn, right)
                turned = False
            move, found = -1, best
            for k in range(4):
                dx, dy = step * ((k == 0) - (k == 1)), step * ((k == 2) - (k == 3))
                score = fit(here, x + dx, y + dy, table, near, reach)
                score -= drawback(x + dx, y + dy, theta, guess, pull)
                if score > found:
                    move, found = k, score
            score = fit(left, x, y, table, near, reach) - drawback(x, y, theta + turn, guess, pull)
            if score > found:
                move, found = 4, score
            score = fit(right, x, y, table, near, reach) - drawback(x, y, theta - turn, guess, pull)
            if score > found:
                move, found = 5, score
            if move < 0:
                break
            best = found
            if move < 4:
                x += step * ((move == 0) - (move == 1))
                y += step * ((move == 2) - (move == 3))
            else:
                theta += turn if move == 4 else -turn
                rotate(points, theta, here)
                turned = True
        step, turn = step / 2.0, turn / 2.0
    return x, y, theta, best


@njit(cache=True)
def drawback(x, y, theta, guess, pull):  # type: ignore[no-untyped-def]
    """What a pose costs for lying off the guess."""
    dx, dy, turn = x - guess[0], y - guess[1], theta - guess[2]
    return pull[0] * (dx * dx + dy * dy) + pull[1] * turn * turn


@njit(cache=True)
def search(points, guess, pull, window, turns, turn, table, near, reach):  # type: ignore[no-untyped-def]
    """The best pose (x, y, theta) of a lattice: `window` cells and `turns` times `turn` rad to each side of `guess`."""
    out = np.array([guess[0], guess[1], guess[2]])
    turned = np.empty((len(points), 2))
    best = -np.inf
    for a in range(-turns, turns + 1):
        theta = guess[2] + a * turn
        rotate(points, theta, turned)
        for j in range(-window, window + 1):
            for i in range(-window, window + 1):
                x, y = guess[0] + i, guess[1] + j
                score = fit(turned, x, y, table, near, reach) - drawback(x, y, theta, guess, pull)
                if score > best:
                    best = score
                    out[0], out[1], out[2] = x, y, theta
    return out


@njit(cache=True)
def climb_all(points, poses, step, turn, halvings, tables, near, reach, spread, worst, enough):  # type: ignore[no-untyped-def]
    """Each particle climbs on its own map: poses (n, 3), misfits (n,), how many points found a wall (n,).

    A particle for which fewer than `enough` points find a wall stays where it was.
    """
    n = len(poses)
    out, misfits, found = poses.copy(), np.empty(n), np.empty(n, np.int64)
    turned, free = np.empty((len(points), 2)), np.zeros(2)
    for k in range(n):
        x, y, theta, _ = climb(points, poses[k], poses[k], free, step, turn, halvings, tables[k], near, reach)
        rotate(points, theta, turned)
        misfits[k], found[k] = misfit(turned, x, y, tables[k], near, spread, worst)
        if found[k] >= enough:
            out[k, 0], out[k, 1], out[k, 2] = x, y, theta
        else:
            rotate(points, poses[k, 2], turned)
            misfits[k], found[k] = misfit(turned, poses[k, 0], poses[k, 1], tables[k], near, spread, worst)
    return out, misfits, found
