"""Where a robot's SLAM instance is in its life.

    OPENING ──Opened──▶ RUNNING ──all taken──▶ FINISHING ──Finished──▶ FINAL
       ▲                   │                       │                     │
       └─── lost, or the stream goes on after all ─┴─────────────────────┘

Each opening is another life of the instance.
"""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    OPENING = "opening"
    RUNNING = "running"
    FINISHING = "finishing"
    FINAL = "final"
