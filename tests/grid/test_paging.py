"""Maps in pages, also of maps that change between the pages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.tiles import TILE_BYTES, tile_page
from common.errors import UsageError
from common.grid import Grid
from common.grid.paging import counts_page, page, parse_cursor
from common.grid.tiles import decode_counts, encode_counts
from common.grid.versions import count_of, first_version, life_of
from common.wire import encode
from common.wire.limits import MAX_PAGE_BYTES

CHANGES = st.lists(st.tuples(st.integers(-2, 2), st.integers(-2, 2), st.integers(0, 9)), max_size=6)


def tile(visits: int) -> np.ndarray:
    return np.full((2, 64, 64), visits, np.uint16)


def change(grid: Grid, changes: list[tuple[int, int, int]]) -> None:
    for x, y, visits in changes:
        grid.replace_if_different([((x, y), tile(visits))])


def take(copy: Grid, owner: Grid, since: int, rounds: list[list[tuple[int, int, int]]], limit: int) -> int:
    """Take pages until there is no next one, with a round of changes at the owner after each; the last version."""
    cursor, left = "", iter(rounds)
    while True:
        found = page(owner, since, cursor, limit, encode_counts)
        copy.replace([((x, y), decode_counts(data, "owner")) for x, y, _, data in found.tiles])
        version = owner.version
        if found.next is None:
            return version
        cursor = found.next
        change(owner, next(left, []))


@settings(max_examples=100, deadline=None)
@given(first=CHANGES, rounds=st.lists(CHANGES, max_size=5), second=CHANGES, limit=st.integers(1, 2000))
def test_whoever_takes_all_pages_of_a_changing_map_has_the_map(
    first: list[tuple[int, int, int]],
    rounds: list[list[tuple[int, int, int]]],
    second: list[tuple[int, int, int]],
    limit: int,
) -> None:
    owner, copy = Grid(0.05, version=first_version(7)), Grid(0.05)
    change(owner, first)
    version = take(copy, owner, 0, rounds, limit)
    assert copy.digest() == owner.digest()
    change(owner, second)
    take(copy, owner, version, rounds, limit)
    assert copy.digest() == owner.digest()


def test_a_version_of_an_earlier_life_has_the_whole_map_sent() -> None:
    old, new = Grid(0.05, version=first_version(9)), Grid(0.05, version=first_version(3))
    for grid in (old, new):
        grid.replace([((0, 0), tile(1))])
        grid.replace([((1, 0), tile(1))])
    assert len(page(new, old.version, "", 10**6, encode_counts).tiles) == 2
    assert len(page(new, new.version, "", 10**6, encode_counts).tiles) == 0


def test_pages_of_two_lives_are_not_put_together() -> None:
    old, new = Grid(0.05, version=first_version(9)), Grid(0.05, version=first_version(3))
    for grid in (old, new):
        grid.replace([((0, 0), tile(1)), ((1, 0), tile(1))])
    cursor = page(old, 0, "", 1, encode_counts).next
    assert cursor is not None
    with pytest.raises(UsageError, match="begun anew"):
        page(new, 0, cursor, 1, encode_counts)


@pytest.mark.parametrize("cursor", ["x", "1.2", "1.2.3.4", "1.a.2"])
def test_a_cursor_that_is_none_is_refused(cursor: str) -> None:
    with pytest.raises(UsageError, match="none of ours"):
        parse_cursor(cursor)


def test_a_tile_above_the_limit_travels_alone() -> None:
    grid = Grid(0.05)
    grid.replace([((0, 0), tile(1)), ((1, 0), tile(2))])
    assert len(page(grid, 0, "", 1, encode_counts).tiles) == 1


@pytest.mark.parametrize("visits", [0, 1])
def test_a_page_of_many_small_tiles_stays_below_what_a_reply_may_hold(visits: int) -> None:
    grid = Grid(0.05, version=first_version(2**32 - 1))
    grid.replace(((x, -70_000), tile(visits)) for x in range(66_000, 76_000))
    found = counts_page(grid, 0, "", TILE_BYTES)
    assert found["next"] is not None
    assert len(encode(tile_page("edge/e1", "counts", found, {}, False, 0))) < MAX_PAGE_BYTES


def test_lives_do_not_meet_however_many_changes_there_are() -> None:
    version = first_version(5) + 123
    assert (life_of(version), count_of(version)) == (5, 123)
    assert first_version(2**32 - 1) < 2**53
