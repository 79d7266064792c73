"""Driving a route: waypoints become a track that keeps a speed, a turn rate and an acceleration.

`turn_then_go` stops at each waypoint, turns on the spot and goes straight on, as the paper's robots do. `smooth`
cuts the corners by arcs and only stops where a corner is too sharp. Either way the drive is a list of blocks that
begin and end at rest; within a block a nominal time runs at rates between 0 and 1, ramped up and down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.errors import ConfigError
from common.geometry import wrap
from common.sim.track import Track

Style = Literal["turn_then_go", "smooth"]

TICK = 0.02
"""s between the poses of a track"""
RAMP = 0.4
"""s from rest to full rate"""
CORNER_RADIUS = 0.3
"""m, of the arcs of `smooth`"""
SHARPEST_ARC = np.radians(120.0)
"""rad, turns beyond this are made on the spot"""


@dataclass(frozen=True)
class Pace:
    """How fast a robot drives."""

    speed_mps: float = 0.5
    turn_radps: float = 0.8

    def __post_init__(self) -> None:
        if not (self.speed_mps > 0 and self.turn_radps > 0):
            raise ConfigError(f"speed_mps and turn_radps must be positive, got {self}")


def drive(waypoints: ArrayLike, pace: Pace, style: Style = "turn_then_go") -> Track:
    """The track along waypoints (n, 2) in metres, from rest at the first, facing the second, to rest at the last.

    Raises ConfigError when fewer than two different waypoints are given.
    """
    points = np.asarray(waypoints, dtype=np.float64)
    points = points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])]
    if len(points) < 2:
        raise ConfigError("a route needs two different waypoints or more")
    legs = np.diff(points, axis=0)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    turns = wrap(np.diff(headings))
    headings = headings[0] + np.concatenate([[0.0], np.cumsum(turns)])
    cuts = _cuts(np.hypot(*legs.T), turns) if style == "smooth" else np.zeros(len(turns))
    return _run(_blocks(points, headings, cuts), pace)


def _cuts(lengths: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far before each corner (n,) its arc begins, metres; 0 turns on the spot."""
    room = 0.45 * np.minimum(lengths[:-1], lengths[1:])
    sharp = np.abs(turns) > SHARPEST_ARC
    cut = np.minimum(CORNER_RADIUS * np.tan(np.minimum(np.abs(turns), SHARPEST_ARC) / 2), room)
    return np.where(sharp | (np.abs(turns) < 1e-6), 0.0, cut)


def _blocks(
    points: NDArray[np.float64], headings: NDArray[np.float64], cuts: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Stretches (k, 3) of poses between rests; theta counts through full turns."""
    blocks: list[NDArray[np.float64]] = []
    moving = [np.array([*points[0], headings[0]])]
    for corner, before, after, cut in zip(points[1:-1], headings[:-1], headings[1:], cuts, strict=True):
        moving.append(_on(corner, before, -cut))
        if cut > 0:
            moving.extend(_arc(corner, before, after, cut))
        elif before != after:
            blocks.append(np.array(moving))
            moving = [np.array([*corner, after])]
            blocks.append(np.array([[*corner, before], moving[0]]))
    moving.append(np.array([*points[-1], headings[-1]]))
    blocks.append(np.array(moving))
    return blocks


def _on(corner: NDArray[np.float64], heading: float, distance: float) -> NDArray[np.float64]:
    return np.array([corner[0] + distance * np.cos(heading), corner[1] + distance * np.sin(heading), heading])


def _arc(corner: NDArray[np.float64], before: float, after: float, cut: float) -> list[NDArray[np.float64]]:
    """Poses along the arc that joins the legs `cut` metres off the corner, without its first."""
    turn = after - before
    radius = cut / np.tan(abs(turn) / 2)
    start = _on(corner, before, -cut)
    side = np.sign(turn)
    centre = start[:2] + side * radius * np.array([-np.sin(before), np.cos(before)])
    thetas = before + turn * np.linspace(0, 1, max(2, int(abs(turn) / np.radians(3)) + 1))[1:]
    return [np.array([*(centre + side * radius * np.array([np.sin(t), -np.cos(t)])), t]) for t in thetas]


def _run(blocks: list[NDArray[np.float64]], pace: Pace) -> Track:
    """Drive the blocks one after the other; ends on a multiple of the tick."""
    stamps, knots, clock = [], [], 0.0
    for block in blocks:
        step = np.abs(np.diff(block, axis=0))
        nominal = np.maximum(np.hypot(step[:, 0], step[:, 1]) / pace.speed_mps, step[:, 2] / pace.turn_radps)
        nominal = np.concatenate([[0.0], np.cumsum(nominal)])
        ramp = min(RAMP, float(nominal[-1]))
        length = float(nominal[-1]) + ramp
        times = np.append(np.arange(0.0, length, TICK), length)
        # from rest at full rate 1: half a ramp is lost at either end
        share = np.where(
            times < ramp,
            times**2 / (2 * ramp),
            np.where(times > length - ramp, nominal[-1] - (length - times) ** 2 / (2 * ramp), times - ramp / 2),
        )
        stamps.append(clock + times[: -1 if block is not blocks[-1] else None])
        poses = np.stack([np.interp(share, nominal, block[:, axis]) for axis in range(3)], axis=-1)
        knots.append(poses[: -1 if block is not blocks[-1] else None])
        clock += length
    return Track(np.concatenate(stamps), np.vstack(knots))
