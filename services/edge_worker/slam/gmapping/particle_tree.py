"""The tree of the particles' trajectories: who descends from whom, and what each saw.

Each registered scan is a generation: a pose for every particle and the particle of the generation before that it
descends from. Of a generation only those are kept who have living descendants. Generations in which all living
particles share one ancestor are settled: of them only that pose remains, so that memory grows with the branches alone,
not with particles times scans.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from services.edge_worker.slam.scan import Points

Pose = NDArray[np.float64]


@dataclass(frozen=True)
class Generation:
    """One registered scan."""

    poses: NDArray[np.float64]
    """(n, 3) of the base in the map frame"""
    parents: NDArray[np.int64]
    """(n,) row in the generation before"""
    points: Points
    """(k, 2) ends in the base frame, m"""
    silent: Points
    """(m, 2) ends of beams that met nothing"""
    laser: NDArray[np.float64]
    """(2,) in the base frame"""


class ParticleTree:
    """All generations, the settled ones as single poses."""

    def __init__(self) -> None:
        self.settled: list[Pose] = []
        self.branches: deque[Generation] = deque()
        self._pruned = 0
        """so many of the branches hold only who had living descendants when `settle` was last called"""

    def __len__(self) -> int:
        return len(self.settled) + len(self.branches)

    def append(self, generation: Generation) -> None:
        """The next generation."""
        self.branches.append(generation)

    def settle(self) -> list[tuple[Pose, Generation]]:
        """Forget who has no living descendants; returns the generations that this settles, oldest first."""
        for row in range(len(self.branches) - 1, 0, -1):
            generation, before = self.branches[row], self.branches[row - 1]
            living = np.zeros(len(before.poses), bool)
            living[generation.parents] = True
            if living.all():
                if row <= self._pruned:
                    break
                continue
            self.branches[row] = replace(generation, parents=(np.cumsum(living) - 1)[generation.parents])
            self.branches[row - 1] = replace(before, poses=before.poses[living], parents=before.parents[living])
        fixed = []
        while len(self.branches) > 1 and len(self.branches[0].poses) == 1:
            pose = self.branches[0].poses[0].copy()
            self.settled.append(pose)
            fixed.append((pose, self.branches.popleft()))
        self._pruned = len(self.branches)
        return fixed

    def ancestors(self, row: int) -> NDArray[np.int64]:
        """For each particle (n,) of the last generation the row of its ancestor in unsettled generation `row`."""
        alive = np.arange(len(self.branches[-1].parents))
        for generation in islice(reversed(self.branches), len(self.branches) - 1 - row):
            alive = generation.parents[alive]
        return alive

    def branch(self, particle: int) -> NDArray[np.float64]:
        """Poses (len(branches), 3) of the unsettled ancestors of a particle of the last generation, and its own."""
        poses = np.empty((len(self.branches), 3))
        for row in range(len(self.branches) - 1, -1, -1):
            poses[row] = self.branches[row].poses[particle]
            particle = int(self.branches[row].parents[particle])
        return poses

    def lineage(self, particle: int) -> NDArray[np.float64]:
        """Poses (len(self), 3) from the first generation to this particle of the last."""
        return np.concatenate([np.array(self.settled).reshape(-1, 3), self.branch(particle)])
