from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = {"numba", "cv2", "scipy", "networkx", "zstandard", "typer"}


def test_nothing_but_the_bus_imports_zenoh() -> None:
    importing = re.compile(r"^\s*(import|from) zenoh\b", re.MULTILINE)
    sources = [path for folder in ("common", "services") for path in (ROOT / folder).rglob("*.py")]
    guilty = [path for path in sources if importing.search(path.read_text())]
    assert {path.parent for path in guilty} == {ROOT / "common" / "bus"}


def test_the_bus_needs_only_what_a_robot_has() -> None:
    program = "import sys, common.bus; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not HEAVY & set(run.stdout.split())
