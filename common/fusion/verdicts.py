"""Verdicts as messages, and the measurements in them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from common.fusion.cycles import Measurement, Pair
from common.fusion.match import Match
from common.wire.edge import PairVerdict


def verdict(found: Match, pair: Pair, versions: tuple[int, int], final: bool, searched: bool) -> PairVerdict:
    """The message about a decided pair, complete with what `solve` needs."""
    information = None if found.information is None else tuple(float(v) for v in found.information.ravel())
    told = found.verdict(*pair, versions)
    return told.model_copy(update={"information": information, "final": final, "searched": searched})


def measurements(verdicts: Iterable[PairVerdict]) -> dict[Pair, Measurement]:
    """The merged ones among the verdicts, as `solve` takes them."""
    out: dict[Pair, Measurement] = {}
    for each in verdicts:
        if each.transform is not None:
            pose = np.asarray(each.transform, np.float64)
            if each.information is None:
                out[each.a, each.b] = Measurement(pose)
            else:
                out[each.a, each.b] = Measurement(pose, np.asarray(each.information, np.float64).reshape(3, 3))
    return out
