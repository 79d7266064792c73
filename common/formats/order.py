"""Which rows of a log are stamped by a clock that was wrong for a while, or set."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import ArrayLike, NDArray


def longest_rising(stamps: ArrayLike) -> NDArray[np.intp]:
    """Indices of the longest row of rising stamps, (m,) out of (n,); of two as long the one that is there first.

    What a wrong clock has stamped is left out, be it one line or a hundred, and costs no line besides.
    """
    values = np.asarray(stamps, np.float64).tolist()
    smallest: list[float] = []  # for each length, the smallest stamp that a rising row of it can end with
    ends: list[int] = []
    before = [-1] * len(values)
    last = -1
    for i, stamp in enumerate(values):
        length = bisect_left(smallest, stamp)
        before[i] = ends[length - 1] if length else -1
        if length == len(ends):
            smallest.append(stamp)
            ends.append(i)
            last = i
        else:
            smallest[length], ends[length] = stamp, i
    chain = []
    while last >= 0:
        chain.append(last)
        last = before[last]
    return np.array(chain[::-1], np.intp)
