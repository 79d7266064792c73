"""A file that a service touches as long as it is up and has its router: what a container's health check looks at."""

from __future__ import annotations

import os
from pathlib import Path

HEARTBEAT = "RECSLAM_HEARTBEAT"
"""environment name of the file; without it nothing is touched"""


def beat() -> None:
    """Called each time that the service has published its status."""
    path = os.environ.get(HEARTBEAT)
    if path:
        Path(path).touch()
