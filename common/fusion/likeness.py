"""How alike two maps are, cheaply: how many key points one rigid transform brings onto each other.

It decides nothing. It tells which pairs are worth a search first, and which must be explained when they lie apart.
"""

from __future__ import annotations

from common.fusion.features import fitting
from common.fusion.matchmap import MatchMap
from common.fusion.settings import FusionSettings

SIGNIFICANT = 12
"""key points that hardly fit by chance: about three times what unlike places usually have in common"""


def likeness(a: MatchMap, b: MatchMap, settings: FusionSettings, seed: int) -> int:
    """Key points of the two maps that the best of some random rigid transforms brings together."""
    return fitting(a.features(settings.features), b.features(settings.features), seed) if settings.features else 0
