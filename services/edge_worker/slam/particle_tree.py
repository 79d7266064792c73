"""The tree of the particles' trajectories: who descends from whom, and what each saw.

Each registered scan is a generation: a pose for every particle and the particle of the generation before that it
descends from. Generations in which all living particles share one ancestor are settled: of them only that pose
remains, so that memory grows with the branches alone, not with particles times scans.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
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
    """(n,) index in the generation before"""
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

    def __len__(self) -> int:
        return len(self.settled) + len(self.branches)

    def append(self, generation: Generation) -> None:
        """The next generation."""
        self.branches.append(generation)

    def settle(self) -> list[tuple[Pose, Generation]]:
        """Prune to single poses what all particles share; returns the generations that this settles, oldest first."""
        if not self.branches:
            return []
        alive = np.arange(len(self.branches[-1].parents))
        ancestors = []
        for generation in reversed(self.branches):
            ancestors.append(alive)
            alive = np.unique(generation.parents[alive])
        fixed = []
        while ancestors and len(ancestors[-1]) == 1 and len(self.branches) > 1:
            pose = self.branches[0].poses[ancestors.pop()[0]].copy()
            self.settled.append(pose)
            fixed.append((pose, self.branches.popleft()))
        return fixed

    def ancestors(self, row: int) -> NDArray[np.int64]:
        """For each particle (n,) of the last generation its ancestor in unsettled generation `row`."""
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
