"""The fusion model continued online: what fusing k maps costs, from the fusions that edges report.

    seconds = map_s k + pair_s k (k - 1) / 2 + m2_s area

Quadratic in the number of maps and aware of their size. A prior keeps what the data do not tell apart (an edge that
always fuses three maps says nothing of twelve); fusions far off the rest lose weight; no time is negative.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from services.scheduler.costs import FusionModel

RECENT = 200
TRUST = 3.0
"""the prior weighs as much as this many fusions"""
ROUNDS = 8
OUTLIER = 1.5
"""typical residuals above which a fusion loses weight, with the square of its residual"""


class FusionTimes:
    """Take in fusions as they are reported; `model` is the best guess at speed 1."""

    def __init__(self, prior: FusionModel) -> None:
        self._prior = prior
        self._seen: deque[tuple[float, float, float, float]] = deque(maxlen=RECENT)
        self._model: FusionModel | None = prior

    def __len__(self) -> int:
        return len(self._seen)

    def took(self, maps: int, area_m2: float, seconds: float) -> None:
        """An edge of speed 1 would have needed `seconds` to fuse `maps` maps into `area_m2`."""
        if maps > 0 and seconds > 0 and np.isfinite([area_m2, seconds]).all():
            self._seen.append((maps, maps * (maps - 1) / 2, area_m2, seconds))
            self._model = None

    @property
    def model(self) -> FusionModel:
        if self._model is None:
            data = np.array(self._seen)
            self._model = FusionModel(*fit(data[:, :3], data[:, 3], self._prior))
        return self._model


def fit(sizes: NDArray[np.float64], seconds: NDArray[np.float64], prior: FusionModel) -> tuple[float, float, float]:
    """(map_s, pair_s, m2_s) from (n, 3) maps, pairs, m² and (n,) s: ridge towards the prior, reweighted."""
    unit = np.maximum([prior.map_s, prior.pair_s, prior.m2_s], 1e-9)
    design = sizes * unit
    typical = max(float(np.median(seconds)), 1e-6)
    keep = np.diag(np.sqrt(TRUST) * np.maximum(np.median(design, axis=0), 1e-3 * typical))
    weights = np.ones(len(seconds))
    found = np.ones(3)
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        found = nnls(np.vstack([design * root[:, None], keep]), np.concatenate([seconds * root, keep @ np.ones(3)]))[0]
        off = np.abs(design @ found - seconds)
        scale = OUTLIER * max(1.4826 * float(np.median(off)), 1e-3 * typical)
        weights = np.minimum(1.0, scale / np.maximum(off, 1e-12)) ** 2
    map_s, pair_s, m2_s = (found * unit).tolist()
    return map_s, pair_s, m2_s
