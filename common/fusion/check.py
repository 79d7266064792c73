"""The matcher's part of a fleet's configuration, checked before anything is started."""

from __future__ import annotations

from pydantic import ValidationError

from common.config import Fleet
from common.errors import ConfigError
from common.fusion.settings import FusionSettings
from common.wire.codec import explain


def check(fleet: Fleet) -> None:
    """Raises ConfigError, naming the field, when the matcher would refuse its settings."""
    try:
        FusionSettings.model_validate(fleet.fusion.settings)
    except ValidationError as error:
        raise ConfigError(f"fusion.settings: {explain(error)}") from error
