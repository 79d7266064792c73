"""Topologies are routing, not code: which edge a robot must go to, and whether robots are regrouped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Topology:
    """One of the fleet file's topologies, seen from the scheduler.

    `recslam` and `edge-only` regroup robots over all edges (they differ in where the cloud merger runs);
    `cloud` and `local` have an edge beside each robot, named after it, and fuse in the cloud only;
    `single-edge` has one edge for everybody.
    """

    name: str

    @property
    def regroups(self) -> bool:
        return self.name in ("recslam", "edge-only")

    def edge_for(self, robot: str, edges: Sequence[str]) -> str | None:
        """The edge that this robot must go to; None: whichever has the least load."""
        if self.name in ("cloud", "local") and f"edge-{robot}" in edges:
            return f"edge-{robot}"
        if self.name == "single-edge":
            return min(edges)
        return None
