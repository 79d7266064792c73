"""The file that health checks look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.heartbeat import HEARTBEAT, beat


def test_a_service_touches_the_file_that_its_environment_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "heartbeat"
    monkeypatch.setenv(HEARTBEAT, str(path))
    beat()
    assert path.exists()


def test_without_a_name_nothing_is_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(HEARTBEAT, raising=False)
    monkeypatch.chdir(tmp_path)
    beat()
    assert not list(tmp_path.iterdir())
