"""How well a pose is known: what a scan's Hessian may be believed of, and what dead reckoning adds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FIRM_M = 0.02
"""standard deviation along the motion of a scan that tells how far the robot went"""
TINY = 1e-12


def believed(information: NDArray[np.float64], scatter: float) -> NDArray[np.float64]:
    """Information (3, 3) of a pose less what it owes to the scatter of normals.

    Normals are fitted to noisy points, and seem to hold the pose along a straight wall: with a variance v of their
    direction, v of what all points say goes astray to the direction across. This much is taken off both directions in
    which the place of the walls is known. The robot may be far from them: how well it knows its own place depends on
    its heading then, and that is known as well, or as badly, as before.
    """
    position, cross, heading = information[:2, :2], information[:2, 2], information[2, 2]
    known, axes = np.linalg.eigh(position)
    known = np.maximum(known, TINY)
    lever = axes @ ((axes.T @ cross) / known)
    kept = (axes * np.maximum(known - scatter * known.sum(), 0.0)) @ axes.T
    out = np.empty((3, 3))
    out[:2, :2] = kept
    out[:2, 2] = out[2, :2] = kept @ lever
    out[2, 2] = max(heading - cross @ lever, 0.0) + lever @ kept @ lever
    return out


def owed(
    seeming: NDArray[np.float64], trusted: NDArray[np.float64], weights: NDArray[np.float64], off: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The step (3,) from the best pose by what the points `seeming`ly know (3, 3) to that by what is `trusted` (3, 3).

    The prior, of diagonal `weights` (3,), lies `off` (3,) from the pose that was found. That pose x solves
    S (x - scan) + P (x - prior) = 0 with S what seems known and P the prior's information; with T, which is trusted, in
    place of S another one does. Along a corridor T holds nothing, and the pose is what the prior says.
    """
    pull = weights * off
    return np.asarray(np.linalg.solve(trusted + np.diag(weights), pull - trusted @ np.linalg.solve(seeming, pull)))


def alone(scan: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (3, 3) of a pose by the information (3, 3) of its scan alone; what it does not hold has 1 m or rad."""
    return np.asarray(np.linalg.inv(scan + np.diag([1.0, 1.0, 1.0])), np.float64)


def holds(covariance: NDArray[np.float64], motion: NDArray[np.float64]) -> bool:
    """Does a scan that alone leaves a `covariance` (3, 3) fix the position along `motion` (3,)?"""
    heading = np.array([np.cos(motion[2]) * motion[0] + np.sin(motion[2]) * motion[1],
                        np.cos(motion[2]) * motion[1] - np.sin(motion[2]) * motion[0]])  # fmt: skip
    return bool(heading @ covariance[:2, :2] @ heading < FIRM_M**2 * (heading @ heading))


def posterior(scan: NDArray[np.float64], sigma: tuple[float, float], slack: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a scan's information (3, 3) leaves of what dead reckoning adds to `slack` (3, 3)."""
    prior = slack + np.diag([sigma[0] ** 2, sigma[0] ** 2, sigma[1] ** 2])
    return np.asarray(np.linalg.inv(scan + np.linalg.inv(prior)), np.float64)


def turned(covariance: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """A covariance (3, 3) in a frame turned by `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn @ covariance @ turn.T


def carried(information: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """What information (3, 3) of a frame, in that frame, says of another one that lies fast at `pose` (3,) in it."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    lever = np.array([[c, -s, pose[1]], [s, c, -pose[0]], [0.0, 0.0, 1.0]])
    return lever.T @ information @ lever
