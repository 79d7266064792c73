"""Weights of particles and low-variance resampling (Grisetti, Stachniss and Burgard 2007, section IV-B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.float64]


def normalised(log_weights: Weights, smoothing: float) -> Weights:
    """Weights (n,) that sum to 1; the logarithms (n,) are divided by `smoothing` times n first (GMapping's ogain)."""
    weights = np.exp((log_weights - log_weights.max()) / (smoothing * len(log_weights)))
    return np.asarray(weights / weights.sum())


def effective(weights: Weights) -> float:
    """How many equal particles are worth as much as these: N_eff = 1 / sum(w^2), from 1 to n."""
    return float(1.0 / np.square(weights).sum())


def systematic(weights: Weights, draw: float) -> NDArray[np.int64]:
    """Indices (n,), rising, of the particles that survive; `draw` in [0, 1) is the only randomness.

    A particle of weight w is kept floor(n w) or ceil(n w) times.
    """
    n = len(weights)
    total = np.cumsum(weights)
    return np.minimum(np.searchsorted(total / total[-1], (draw + np.arange(n)) / n, side="right"), n - 1)
