"""Settings that only an edge understands, checked before anything is started."""

from __future__ import annotations

from pydantic import ValidationError

from common.config import Fleet
from common.errors import ConfigError
from common.fusion.settings import FusionSettings
from common.wire.codec import explain
from services.edge_worker.slam.kernel import create


def check(fleet: Fleet) -> None:
    """Raises ConfigError, naming the field, when the kernel or the matcher would refuse its settings."""
    create(fleet.slam.kernel, fleet.slam.settings, fleet.seed)
    try:
        FusionSettings.model_validate(fleet.fusion.settings)
    except ValidationError as error:
        raise ConfigError(f"fusion.settings: {explain(error)}") from error
