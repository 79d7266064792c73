"""Settings of the `gmapping` kernel; units are in the names, every field has a default.

The defaults serve lasers of the SICK (80 m), RPLIDAR A1 (12 m) and LDS-01 (3.5 m) classes alike: what a laser can see
comes with each frame.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator


class GMappingSettings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    particles: Annotated[int, Field(ge=1, le=1000)] = 30
    resolution_m: Annotated[float, Field(ge=0.01, le=0.5)] = 0.05
    """cell of the particles' maps and of the robot map"""
    range_m: Annotated[float, Field(gt=0, le=100)] = 40.0
    """beams that end further off are dropped"""
    clear_m: Annotated[float, Field(ge=0, le=60)] = 0.0
    """beams that met nothing (+inf) clear the robot map this far; 0: not at all"""
    match_points: Annotated[int, Field(ge=20, le=2000)] = 180
    """most points of a scan that are matched; all are mapped"""
    min_points: Annotated[int, Field(ge=3)] = 12
    """a scan with fewer points is neither matched nor mapped"""
    min_found: Annotated[float, Field(ge=0, le=1)] = 0.4
    """share of the points that must end beside a wall of the map for a match to count"""
    register_m: Annotated[float, Field(gt=0, le=5)] = 0.3
    register_rad: Annotated[float, Field(gt=0, le=3.2)] = 0.25
    """a scan this far from the last registered one is registered in every particle's map"""
    reach_m: Annotated[float, Field(gt=0)] = 0.15
    """a point this far from a wall scores nothing in matching; at most three cells"""
    step_m: Annotated[float, Field(gt=0, le=0.5)] = 0.05
    step_rad: Annotated[float, Field(gt=0, le=0.5)] = 0.05
    """first moves of the hill climb"""
    halvings: Annotated[int, Field(ge=0, le=10)] = 5
    """how often the moves are halved"""
    odometry_m_per_m: Annotated[float, Field(gt=0, le=2)] = 0.1
    odometry_rad_per_rad: Annotated[float, Field(gt=0, le=2)] = 0.1
    odometry_rad_per_m: Annotated[float, Field(gt=0, le=2)] = 0.05
    """standard deviation of dead reckoning by odometry"""
    guess_mps2: Annotated[float, Field(gt=0, le=100)] = 2.0
    guess_radps2: Annotated[float, Field(gt=0, le=100)] = 6.0
    """accelerations that a guess of constant velocity must reckon with"""
    drift_m_per_sqrt_m: Annotated[float, Field(ge=0, le=1)] = 0.02
    drift_rad_per_sqrt_m: Annotated[float, Field(ge=0, le=1)] = 0.011
    drift_rad_per_sqrt_rad: Annotated[float, Field(ge=0, le=1)] = 0.02
    """standard deviation of the particles' spread about matched motion, which grows as a random walk"""
    prior_share: Annotated[float, Field(ge=0, le=1)] = 0.005
    """a pose one standard deviation off dead reckoning costs half this share of a perfect score"""
    search_m: Annotated[float, Field(ge=0, le=2)] = 0.5
    search_rad: Annotated[float, Field(ge=0, le=1)] = 0.5
    """most that the search around dead reckoning looks off to each side"""
    likelihood_m: Annotated[float, Field(gt=0, le=1)] = 0.1
    """standard deviation of a point about its wall, as particles are weighed"""
    likelihood_worst: Annotated[float, Field(gt=0, le=100)] = 2.0
    """most that one point takes from a particle's log-likelihood"""
    smoothing: Annotated[float, Field(gt=0, le=1000)] = 3.0
    """log-likelihoods are divided by this times the particles (GMapping's ogain): beams are not independent"""
    resample_share: Annotated[float, Field(ge=0, le=1)] = 0.5
    """particles are resampled when fewer than this share are effective"""
    lag_scans: Annotated[int, Field(ge=10, le=100_000)] = 3000
    """registered scans back to which particles may disagree; of what is older only the heaviest one's is kept"""

    @model_validator(mode="after")
    def reach_is_seen(self) -> GMappingSettings:
        if self.reach_m > 3.0 * self.resolution_m + 1e-9:
            raise ValueError(f"reach_m is over three cells of {self.resolution_m} m; at most {3 * self.resolution_m:g}")
        return self
