"""Planar geometry: poses in SE(2) and transforms between frames."""

from common.geometry.se2 import IDENTITY, apply, between, compose, interpolate, inverse, wrap

__all__ = ["IDENTITY", "apply", "between", "compose", "interpolate", "inverse", "wrap"]
