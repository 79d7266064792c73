"""Matches a scan with the particles' maps: tracks one particle from frame to frame, lets all climb at registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.edge_worker.slam.gmapping.hill_climb import climb, climb_all, found_walls, search
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.gmapping.settings import GMappingSettings
from services.edge_worker.slam.scan import Points, Scan, unslipped

SEARCH_POINTS = 90
"""the coarse search matches so many points at most"""
FINEST_TURN_RAD = 0.01
SLIP_RADPS, SLIP_ROUNDS, SLIP_GAIN = 0.6, 6, 1.002
"""first change of the turn rate that is tried, how often, and the share by which it must better the score"""
WIDE = 2.5
"""the search looks so many standard deviations to each side"""
POOR = 0.75
"""share of the points that find walls below which a scan is sought again, far and wide: stamps lie, wheels stall"""
WIDER, WIDER_M, WIDER_RAD = 8.0, 0.02, 0.01
"""times dead reckoning's standard deviation, and how much more, of that search"""
NEARLY_ALL, MUCH_BETTER = 0.85, 0.2
"""share of the points that must find walls there, and by which it must be better: else the scan sees what is new"""


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviation of dead reckoning."""

    metres: float
    radians: float


class ParticleMatcher:
    """Scan matching on the maps of `maps`. Poses are (x m, y m, theta rad) in the map frame."""

    def __init__(self, settings: GMappingSettings, maps: PatchMap) -> None:
        self.settings = settings
        self.maps = maps

    def track(
        self, points: Points, guess: NDArray[np.float64], doubt: Uncertainty, particle: int
    ) -> tuple[NDArray[np.float64], bool]:
        """The pose (3,) near `guess` where `points` (n, 2) fit one particle's map, and whether they do."""
        cells = self._thinned(points, self.settings.match_points)
        pose, found = self._near(cells, guess, doubt, particle)
        if found < POOR:
            wide = Uncertainty(WIDER * doubt.metres + WIDER_M, WIDER * doubt.radians + WIDER_RAD)
            elsewhere, agree = self._near(cells, guess, wide, particle)
            if agree > max(NEARLY_ALL, found + MUCH_BETTER):
                pose, found = elsewhere, agree
        return (guess, False) if found < self.settings.min_found else (pose, True)

    def _near(
        self, cells: NDArray[np.float64], guess: NDArray[np.float64], doubt: Uncertainty, particle: int
    ) -> tuple[NDArray[np.float64], float]:
        """The best pose (3,) near `guess` of points (n, 2) in cells, and the share of them that finds walls there."""
        pull = self._pull(doubt, len(cells))
        start = self._search(cells, self._cells(guess), pull, doubt, particle)
        x, y, theta, _ = climb(cells, start, self._cells(guess), pull, *self._climbing(), *self._map(particle))
        pose = np.array([x, y, theta])
        found = found_walls(cells, pose, self.maps.table[particle], self.maps.pool.near)
        return self._metres(pose), found / len(cells)

    def unslip(
        self, scan: Scan, pose: NDArray[np.float64], doubt: Uncertainty, particle: int
    ) -> tuple[Scan, NDArray[np.float64], NDArray[np.float64]]:
        """Where the velocity within the sweep was a guess: the turn rate, and with it the pose, that fit best.

        Returns the scan compensated anew, its pose (3,), and what the guess was off by (3,): m/s, m/s, rad/s.
        """
        best, (reached, score) = scan, self._refine(scan.points, pose, doubt, particle)
        slip, step = 0.0, SLIP_RADPS
        for _ in range(SLIP_ROUNDS):
            for tried in (slip - step, slip + step):
                turned = unslipped(scan, np.array([0.0, 0.0, tried]))
                there, gain = self._refine(turned.points, pose, doubt, particle)
                if gain > score * SLIP_GAIN:
                    best, reached, score, slip = turned, there, gain, tried
                    break
            else:
                step /= 2.0
        return best, reached, np.array([0.0, 0.0, slip])

    def _refine(
        self, points: Points, pose: NDArray[np.float64], doubt: Uncertainty, particle: int
    ) -> tuple[NDArray[np.float64], float]:
        cells = self._thinned(points, self.settings.match_points)
        start = self._cells(pose)
        x, y, theta, score = climb(
            cells, start, start, self._pull(doubt, len(cells)), *self._climbing(), *self._map(particle)
        )
        return self._metres(np.array([x, y, theta])), score

    def climb(self, points: Points, poses: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Every particle climbs from its pose (n, 3) on its own map: the poses reached, and log-likelihoods (n,)."""
        s, cells = self.settings, self._thinned(points, self.settings.match_points)
        reached, misfits, _ = climb_all(
            cells,
            self._cells(poses),
            *self._climbing(),
            self.maps.table,
            self.maps.pool.near,
            s.reach_m / s.resolution_m,
            s.likelihood_m / s.resolution_m,
            s.likelihood_worst,
            s.min_found * len(cells),
        )
        return self._metres(reached), -misfits

    def _search(
        self,
        cells: NDArray[np.float64],
        guess: NDArray[np.float64],
        pull: NDArray[np.float64],
        doubt: Uncertainty,
        particle: int,
    ) -> NDArray[np.float64]:
        s = self.settings
        coarse = np.ascontiguousarray(cells[:: -(-len(cells) // SEARCH_POINTS)])
        lever = float(np.sqrt(np.square(coarse).sum(axis=1).mean()))
        turn = float(np.clip(1.0 / max(lever, 1.0), FINEST_TURN_RAD, s.step_rad))
        window = int(np.ceil(min(WIDE * doubt.metres, s.search_m) / s.resolution_m))
        turns = int(np.ceil(min(WIDE * doubt.radians, s.search_rad) / turn))
        pull = pull * (len(coarse) / len(cells))
        return search(coarse, guess, pull, window, turns, turn, *self._map(particle))

    def _thinned(self, points: Points, most: int) -> NDArray[np.float64]:
        """At most `most` of the points, evenly taken, in cells."""
        if len(points) > most:
            points = points[np.linspace(0, len(points) - 1, most).astype(np.int64)]
        return points.astype(np.float64) / self.settings.resolution_m

    def _pull(self, doubt: Uncertainty, points: int) -> NDArray[np.float64]:
        scale = 0.5 * self.settings.prior_share * points
        cells = max(doubt.metres, 1e-3) / self.settings.resolution_m
        return scale / np.square([cells, max(doubt.radians, 1e-3)])

    def _climbing(self) -> tuple[float, float, int]:
        return self.settings.step_m / self.settings.resolution_m, self.settings.step_rad, self.settings.halvings

    def _map(self, particle: int) -> tuple[NDArray[np.int32], NDArray[np.int16], float]:
        return self.maps.table[particle], self.maps.pool.near, self.settings.reach_m / self.settings.resolution_m

    def _cells(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([self.maps.to_table(poses[..., :2]), poses[..., 2:]], axis=-1)

    def _metres(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([self.maps.to_metres(poses[..., :2]), poses[..., 2:]], axis=-1)
