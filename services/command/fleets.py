"""Fleet files: found by path or by the name of one that comes along, written back as they took effect."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import TypeAdapter, ValidationError

from common.config import Fleet, dump, load
from common.errors import ConfigError
from common.wire.codec import explain

BUILT_IN = Path(__file__).parent.parent / "fleets"


def built_in() -> list[str]:
    """Names of the fleets that come along."""
    return sorted(path.stem for path in BUILT_IN.glob("*.toml"))


def find(name: str) -> Path:
    """The fleet file at the path `name`, or the one of that name that comes along. Raises ConfigError."""
    path, own = Path(name), BUILT_IN / f"{name}.toml"
    if path.is_file():
        return path
    if name in built_in():
        return own
    raise ConfigError(f"{name}: no such file, and none of the fleets that come along: {', '.join(built_in())}")


def load_fleet(name: str, **overrides: Any) -> Fleet:
    """The fleet as `find` finds it; `overrides` that are None leave the file's word. Raises ConfigError."""
    fleet = load(find(name))
    given = {key: value for key, value in overrides.items() if value is not None}
    return revised(fleet, **given) if given else fleet


def revised(fleet: Fleet, **fields: Any) -> Fleet:
    """The fleet with other top-level fields or, as `scheduler={"policy": ...}`, with other fields in a section.

    These go before the environment, too. Raises ConfigError.
    """
    return fleet.model_copy(update={name: _checked(fleet, name, value) for name, value in fields.items()})


def write(fleet: Fleet, path: Path) -> None:
    """Write the effective configuration as a fleet file that gives this fleet again."""
    path.write_text(tomli_w.dumps(_told(dump(fleet))))


def same_frames(fleet: Fleet, path: Path) -> bool:
    """Whether the fleet that `write` has left at `path` drives the same robots in the same way."""
    try:
        before = tomllib.loads(path.read_text())
    except (OSError, ValueError):
        return False
    return _driven(before) == _driven(_told(dump(fleet)))


def _driven(data: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    return data.get("seed"), {robot["id"]: robot["source"] for robot in data.get("robots", ())}


def _checked(fleet: Fleet, name: str, value: Any) -> Any:
    if isinstance(value, dict):
        value = getattr(fleet, name).model_dump() | value
    kind: Any = Fleet.model_fields[name].annotation
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        raise ConfigError(f"{name}: {explain(error)}") from error


def _told(value: Any) -> Any:
    """Without what is None: TOML has no word for it, and it is every such field's default."""
    if isinstance(value, dict):
        return {key: _told(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_told(item) for item in value]
    return value
