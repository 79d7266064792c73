"""State machines know no clock, no network and no chance."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PURE = [
    "common/presence.py",
    "services/edge_worker/backlog.py",
    "services/edge_worker/checkpoint.py",
    "services/edge_worker/instance.py",
    "services/edge_worker/instructions.py",
    "services/edge_worker/phase.py",
    "services/edge_worker/state.py",
    "services/edge_worker/fusing.py",
    "services/cloud_merger/changes.py",
    "services/cloud_merger/events.py",
    "services/cloud_merger/state.py",
    "services/cloud_merger/trace.py",
    "services/scheduler/events.py",
    "services/scheduler/overload.py",
    "services/scheduler/state.py",
    "services/scheduler/topology.py",
    "services/robot_agent/state.py",
]
FORBIDDEN = {"asyncio", "time", "datetime", "zenoh", "random", "secrets", "uuid", "threading", "os", "socket"}


@pytest.mark.parametrize("path", PURE)
def test_a_state_machine_imports_nothing_impure(path: str) -> None:
    names = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names.add(node.module.split(".")[0])
            assert not node.module.startswith("common.bus"), "state machines do not know the bus"
    assert not names & FORBIDDEN
