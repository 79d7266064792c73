"""Where the cluster is that a command shall talk to."""

from __future__ import annotations

import os
from dataclasses import dataclass

from common.bus import Bus
from common.config import load
from common.errors import RouterUnreachable
from common.service import ENDPOINT
from services.command.run_folder import CLUSTER, LATEST, read_cluster

TIMEOUT_S = 3.0
"""so that a command ends within 5 s when there is no router"""


@dataclass(frozen=True)
class Place:
    endpoint: str
    root: str
    found: str
    """how it was found, for the operator"""

    async def open(self) -> Bus:
        """Raises RouterUnreachable, naming the endpoint and how it was found."""
        try:
            return await Bus.open(self.endpoint, name="command", role="command", root=self.root, timeout_s=TIMEOUT_S)
        except RouterUnreachable as error:
            raise RouterUnreachable(f"{error}; the endpoint comes from {self.found}") from error


def find(endpoint: str | None) -> Place:
    """By `endpoint`, else `runs/latest/cluster.json`, else $RECSLAM_ENDPOINT, else the configuration's default.

    Raises BadFile when the cluster file is none.
    """
    default = load(None).bus
    latest = LATEST / CLUSTER
    if endpoint:
        return Place(endpoint, default.root, "--endpoint")
    if latest.is_file():
        cluster = read_cluster(latest)
        return Place(cluster.endpoint, cluster.root, str(latest))
    if named := os.environ.get(ENDPOINT):
        return Place(named, default.root, f"${ENDPOINT}")
    return Place(default.endpoint, default.root, "the default, as no cluster runs from this folder")
