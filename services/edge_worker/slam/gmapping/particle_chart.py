"""The published map: the best particle's lineage, ray traced into counts.

While the ancestry stays, only new scans are drawn. When another lineage becomes best, the scans since the common
ancestor are taken away and drawn where that lineage has them: counts are sums, so this gives the same map as drawing
all anew, at the cost of the branch alone. That may be hundreds of scans, and the robot waits for its pose meanwhile: so
a map that is asked for on the way moves the latest few of them and leaves the rest to the next time.
"""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from common.grid import Grid
from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.gmapping.particle_tree import Generation, ParticleTree, Pose
from services.edge_worker.slam.raycast import Canvas


class ParticleChart:
    """A grid that follows one lineage of a tree."""

    def __init__(self, resolution_m: float) -> None:
        self.grid = Grid(resolution_m)
        self.canvas = Canvas(resolution_m)
        self.corrections = Corrections(resolution_m)
        self.drawn: list[Pose] = []
        """where the tree's first unsettled generations are drawn"""
        self.followed: tuple[int, int] | None = None
        """generations of the tree and the particle of the last one whose lineage is drawn, when all of it is"""

    def follow(self, tree: ParticleTree, particle: int, most: int | None = None) -> None:
        """Draw the lineage of this particle and bring the grid up to date.

        New scans are all drawn; of those drawn elsewhere, the latest `most` are moved.
        """
        if self.followed == (len(tree), particle):
            return
        branch = tree.branch(particle)
        known = len(self.drawn)
        elsewhere = np.flatnonzero((np.array(self.drawn).reshape(-1, 3) != branch[:known]).any(axis=1))
        left = 0 if most is None else max(0, len(elsewhere) - most)
        for row in elsewhere[left:]:
            self._move(row, branch[row], tree.branches[row])
        for pose, generation in zip(branch[known:], islice(tree.branches, known, None), strict=True):
            self._draw(pose, generation, 1)
            self.drawn.append(pose)
        self.canvas.publish(self.grid)
        self.corrections.shown()
        self.followed = None if left else (len(tree), particle)

    def settle(self, fixed: list[tuple[Pose, Generation]]) -> None:
        """Generations are leaving the tree's branches, oldest first: draw them for good."""
        for pose, generation in fixed:
            if self.drawn:
                self._move(0, pose, generation)
                self.drawn.pop(0)
            else:
                self._draw(pose, generation, 1)

    def _move(self, row: int, pose: Pose, generation: Generation) -> None:
        if not np.array_equal(self.drawn[row], pose):
            self.corrections.moves(generation.points, self.drawn[row], pose)
            self._draw(self.drawn[row], generation, -1)
            self._draw(pose, generation, 1)
            self.drawn[row] = pose

    def _draw(self, pose: NDArray[np.float64], generation: Generation, times: int) -> None:
        self.canvas.draw(pose, generation.points, generation.laser, generation.silent, times)
