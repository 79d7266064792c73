"""Versions of a map that is kept in memory: a life above, a count of changes below, in one integer.

A map that is made anew (its process died, its robot began again) must not be taken for a continuation of the old one
only because their counts meet. Each maker therefore begins at a life of its own, and a reader who has a version of
another life takes the whole map again.
"""

from __future__ import annotations

COUNT_BITS = 20
"""a count that runs over into the life makes readers take the whole map once more, no harm else"""
LIVES = 1 << 32
"""52 bits in all: exact in a browser, too"""


def first_version(life: int) -> int:
    """The version of a map of this life in which nothing has been set yet."""
    return (life % LIVES) << COUNT_BITS


def life_of(version: int) -> int:
    return version >> COUNT_BITS


def count_of(version: int) -> int:
    """The count alone, for people to read."""
    return version & ((1 << COUNT_BITS) - 1)
