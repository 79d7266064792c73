"""`recslam profile` times real work and writes what the scheduler reads."""

from __future__ import annotations

import pytest

from common.errors import ConfigError
from services.command import profile as profiling
from services.scheduler.profile import FusionTime, load_profile


async def test_a_profile_is_measured_in_workers_and_read_back(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(profiling, "MAPS", (1, 2))
    monkeypatch.setattr(profiling, "SENSORS", ("lds01",))
    lines = [line async for line in profiling.profile("graph", 2.0, tmp_path / "profile.toml")]
    found = load_profile(tmp_path / "profile.toml")
    assert found.kernel == "graph"
    assert 0 < found.slam_s["lds01"] < 1
    assert [each.maps for each in found.fusions] == [1, 2]
    assert len(lines) == 4


async def test_a_kernel_that_there_is_not_is_refused_before_anything_is_timed(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"slam\.kernel"):
        await anext(profiling.profile("grph", 2.0, tmp_path / "profile.toml"))


def test_the_fitted_model_gives_the_times_it_was_fitted_to() -> None:
    times = [FusionTime(maps=k, area_m2=100, seconds=0.1 * k + 0.05 * k * (k - 1) / 2) for k in (2, 3, 4, 6, 8, 12)]
    found = profiling.fitted({}, times, "graph")
    for each in times:
        assert abs(float(found.fusion.seconds(each.maps, each.area_m2)) - each.seconds) < 0.2 * each.seconds
