"""Results of benches: printed as they come, kept in results/, one file a bench, one part at a time."""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

RESULTS = Path("results")


def append(bench: str, parts: dict[str, Any]) -> Path:
    """Put these parts into results/<bench>.json beside what other runs have left there."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{bench}.json"
    kept: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    path.write_text(json.dumps({**kept, **parts, "machine": machine}, indent=1))
    return path


def show(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        print(
            "  ".join(
                f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value!s}" for key, value in row.items()
            ),
            flush=True,
        )
