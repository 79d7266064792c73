"""Settings of the `graph` kernel; units are in the names, every field has a default."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class GraphSettings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    resolution_m: Annotated[float, Field(ge=0.02, le=0.5)] = 0.05
    """cell of the robot map"""
    range_m: Annotated[float, Field(gt=0, le=60)] = 30.0
    """points further off are dropped"""
    clear_m: Annotated[float, Field(ge=0, le=60)] = 0.0
    """beams that met nothing (+inf) clear the map this far; 0: not at all, as glass and black things look the same"""
    min_points: Annotated[int, Field(ge=3)] = 12
    """a scan with fewer points on walls is not matched"""
    match_points: Annotated[int, Field(ge=20, le=2000)] = 360
    """most points of a scan that are matched"""
    keyframe_m: Annotated[float, Field(gt=0, le=5)] = 0.3
    keyframe_rad: Annotated[float, Field(gt=0, le=3.2)] = 0.3
    """a scan this far from the last keyframe becomes one"""
    local_keyframes: Annotated[int, Field(ge=5, le=500)] = 60
    """keyframes of the sliding map that scans are matched with"""
    max_keyframes: Annotated[int, Field(ge=50)] = 2000
    """with more than this, views of crowded places are dropped: memory and time stay bounded"""
    submap_keyframes: Annotated[int, Field(ge=3, le=100)] = 10
    min_inliers: Annotated[float, Field(gt=0, le=1)] = 0.4
    """share of a scan's points that must agree with the map for the match to count"""
    odometry_share: Annotated[float, Field(gt=0, le=2)] = 0.15
    """standard deviation of odometry per metre or radian moved"""
    loop_radius_m: Annotated[float, Field(ge=0, le=20)] = 2.0
    """loops are looked for this far around"""
    loop_growth: Annotated[float, Field(ge=0, le=1)] = 0.03
    """metres by which that radius grows per metre travelled since the last loop"""
    loop_radius_max_m: Annotated[float, Field(ge=0, le=50)] = 12.0
    loop_inliers: Annotated[float, Field(gt=0, le=1)] = 0.65
    """share of points that must agree with a submap for a loop to count"""
