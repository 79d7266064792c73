"""What the matcher may be told; every field has its unit in its name."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class FusionSettings(BaseModel):
    """Settings of `match`, `track` and `solve`; the defaults hold for indoor laser maps of 2.5 to 10 cm cells."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # propose
    coarse_m: Positive = 0.25
    """cell of the correlation search"""
    rotations: Annotated[int, Field(ge=1, le=180)] = 4
    """candidate rotations from the wall orientations, each with its opposite"""
    peaks: Annotated[int, Field(ge=1, le=100)] = 8
    """translations kept per rotation"""
    repulsion: Annotated[float, Field(ge=0)] = 0.5
    """how strongly free space repels walls in the correlation, relative to wall on wall"""
    features: Annotated[int, Field(ge=0, le=10_000)] = 500
    """ORB key points per map; 0 switches the feature proposals off"""
    feature_hypotheses: Annotated[int, Field(ge=1, le=20)] = 4
    """distinct transforms taken from the feature matches"""

    # refine
    reach_m: Positive = 0.5
    """how far refinement looks for a wall at first"""
    refined: Annotated[int, Field(ge=1, le=500)] = 24
    """hypotheses refined to the end"""

    # verify
    tolerance_m: Positive = 0.12
    """a wall within this of a wall agrees with it"""
    contradiction_m: Positive = 0.25
    """a wall in free space farther than this from any wall contradicts"""

    max_bend_m: Positive = 1.5
    """how far drift may carry any place of a map from where a rigid transform puts it"""
    max_bend_rad: Positive = 0.15

    # decide
    min_walls_m: Positive = 6.0
    """a map with less wall is not compared"""
    min_overlap_m2: Positive = 10.0
    """area known to both that a merge must rest on"""
    min_score_m: Positive = 10.0
    """score (metres of agreeing wall less what contradictions cost) that a merge must have"""
    min_quality: Share = 0.62
    """score over metres of wall in the overlap that a merge must have"""
    max_blob_m: Positive = 1.5
    """longest coherent contradiction that a merge may have"""
    max_runner_up: Share = 0.75
    """score of a distinct other hypothesis over the best, from which on a place counts as ambiguous ..."""
    clear_lead_m: Positive = 8.0
    """... unless the best leads by so much, which needs large maps ..."""
    max_runner_up_ever: Share = 0.9
    """... and even then up to here"""
    min_grip_m: Positive = 1.0
    """metres of wall across the transform's weakest direction, below which it counts as ambiguous"""

    min_distinction_m: Annotated[float, Field(ge=0)] = 4.0
    """metres by which a merge must be set apart from places of its shape (detail.py), 0 to do without ..."""
    plain_overlap: Annotated[float, Field(ge=0, le=0.5)] = 0.4
    """... unless the maps overlap by so much, |A∩B| / (|A|+|B|)"""

    # decide about bent maps, which fit patch by patch only
    min_bent_score_m: Positive = 30.0
    """score that a merge must have then"""
    min_bent_quality: Share = 0.45
    """score over metres of wall in the overlap"""
    max_bent_runner_up: Share = 0.5
    """score of a distinct other hypothesis over the best"""
    min_bent_grip_m: Positive = 3.0
    """metres of wall across the transform's weakest direction"""
    bent_blob: Share = 0.01
    """longest coherent contradiction beyond `max_blob_m`, per metre of agreeing wall"""

    # solve
    max_cycle_m: Positive = 0.5
    """a cycle of merged pairs that fails to close by more than this holds a wrong pair"""
    max_cycle_rad: Positive = 0.05
