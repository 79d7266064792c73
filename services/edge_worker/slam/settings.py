"""A kernel's settings as read from the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from common.errors import ConfigError
from common.wire.codec import explain

Settings = TypeVar("Settings", bound=BaseModel)


def read_settings(kind: type[Settings], settings: Mapping[str, Any]) -> Settings:
    """Raises ConfigError naming the field."""
    try:
        return kind(**settings)
    except ValidationError as error:
        raise ConfigError(f"slam.settings: {explain(error)}") from error
