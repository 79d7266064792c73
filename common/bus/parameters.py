"""Parameters of queries: whoever asks gives them as text."""

from __future__ import annotations

from collections.abc import Mapping

from common.errors import UsageError

MOST_DIGITS = 18
"""with any more a number may not fit into 64 bits"""


def number(params: Mapping[str, str], name: str, default: int = 0) -> int:
    """A parameter that counts from 0, `default` where it is left out. Raises UsageError when it is no such number."""
    text = params.get(name)
    if text is None:
        return default
    if not (text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS):
        raise UsageError(f"parameter {name}={text[:64]!r} is no number of 0 to {10**MOST_DIGITS - 1}")
    return int(text)
