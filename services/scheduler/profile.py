"""What one machine was measured to need before any robot came: written by `recslam profile`, read at start."""

from __future__ import annotations

import tomllib
from pathlib import Path
from statistics import median
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from common.errors import ConfigError
from common.wire.codec import explain
from services.scheduler.costs import FusionModel

Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class FusionTime(BaseModel):
    """One fusion that was timed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    maps: Annotated[int, Field(ge=1)]
    area_m2: Seconds
    """of the fused map"""
    seconds: Seconds


class Profile(BaseModel):
    """Times at speed 1, which is that of the machine profiled."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    machine: str = ""
    kernel: str = ""
    slam_s: dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]] = {}
    """sensor → median seconds of a scan"""
    map_s: Seconds = FusionModel.map_s
    pair_s: Seconds = FusionModel.pair_s
    m2_s: Seconds = FusionModel.m2_s
    fusions: tuple[FusionTime, ...] = ()
    """what the three figures above were fitted to"""

    def scan_s(self, sensor: str) -> float | None:
        """Of this sensor, else of a middling one; None when no scan was timed."""
        return self.slam_s.get(sensor) or (median(self.slam_s.values()) if self.slam_s else None)

    @property
    def fusion(self) -> FusionModel:
        return FusionModel(self.map_s, self.pair_s, self.m2_s)


def load_profile(path: Path | None) -> Profile:
    """The profile in this TOML file, or the built-in guesses. Raises ConfigError naming scheduler.profile."""
    if path is None:
        return Profile()
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text())
        return Profile.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"scheduler.profile: {path}: {explain(error)}") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"scheduler.profile: {path}: {error}; make one by `recslam profile --out {path}`") from error
