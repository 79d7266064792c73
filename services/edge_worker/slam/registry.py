"""Which kernels there are, by the name that the configuration gives: two of our own, others by entry point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any

from common.errors import ConfigError
from services.edge_worker.slam.kernel import Kernel

ENTRY_POINT_GROUP = "recslam.kernels"

KernelFactory = Callable[[Mapping[str, Any], int], Kernel]
"""(settings as read from the configuration, seed) -> kernel; raises ConfigError naming the field"""


def create(name: str, settings: Mapping[str, Any], seed: int = 0) -> Kernel:
    """A new kernel by its name in the configuration. Raises ConfigError for unknown names or settings."""
    if name == "graph":
        from services.edge_worker.slam.graph.graph_slam import GraphSlam

        return GraphSlam.create(settings, seed)
    if name == "gmapping":
        from services.edge_worker.slam.gmapping.gmapping import GMapping

        return GMapping.create(settings, seed)
    plugins = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    if name not in plugins:
        known = ", ".join(["graph", "gmapping", *sorted(plugins)])
        raise ConfigError(f"slam.kernel: no kernel is called {name!r}; there are: {known}")
    factory: KernelFactory = plugins[name].load()
    return factory(settings, seed)
