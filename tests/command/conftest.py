"""A short recorded run, which every test of a cluster replays."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import call, write_fleet


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a recorded run of two robots in one room, 20 s each."""
    folder = tmp_path_factory.mktemp("recording")
    done = call("record", write_fleet(folder), "--out", folder / "pair", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "pair"
