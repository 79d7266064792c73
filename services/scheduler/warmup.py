"""Compile all that planning needs, so that no first plan waits for it."""

from __future__ import annotations

import numpy as np

from services.scheduler.cut import SMALL
from services.scheduler.offline import compiled, uniform_problem
from services.scheduler.policies import POLICIES


def warmup() -> None:
    """Plan by every policy for a ring of robots; compiled code is kept on disk for the next process."""
    near = np.eye(SMALL + 1, k=1) + np.eye(SMALL + 1, k=SMALL)
    problem = uniform_problem(0.25 * (near + near.T), edges=2)
    for policy in POLICIES:
        compiled(problem, policy, kappa=100, tau=10)
