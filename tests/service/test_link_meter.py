"""Speed and delay of a link out of pages."""

from __future__ import annotations

import random

import pytest

from common.link import LinkMeter, line


def test_speed_and_delay_are_told_apart_when_pages_differ_in_size() -> None:
    rng = random.Random(1)
    pages = [(size, 0.02 + size / 2e6 * rng.uniform(0.9, 1.1)) for size in range(10_000, 250_000, 10_000)]
    speed, delay = line(pages)
    assert speed == pytest.approx(2e6, rel=0.1)
    assert delay == pytest.approx(0.02, abs=0.01)


def test_a_few_pages_that_waited_for_something_else_do_not_count() -> None:
    pages = [(size, size / 1e6) for size in range(10_000, 250_000, 10_000)]
    pages[3], pages[9], pages[20] = (40_000, 5.0), (100_000, 9.0), (210_000, 30.0)
    assert line(pages)[0] == pytest.approx(1e6, rel=0.05)


def test_pages_of_one_size_tell_a_delay_and_no_speed() -> None:
    meter = LinkMeter()
    for seconds in (0.1, 0.3, 0.3, 4.0):
        meter.took("robot/r1", 50_000, seconds)
    meter.took("robot/r2", 0, 0.1)
    (status,) = meter.statuses()
    assert (status.peer, status.pages) == ("robot/r1", 4)
    assert (status.bytes_per_s, status.delay_s) == pytest.approx((0.0, 0.3))
