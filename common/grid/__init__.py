"""Tiled occupancy grids: counts per cell, versions, deltas, rendering."""

from common.grid.grid import TILE, Grid, TileKey

__all__ = ["TILE", "Grid", "TileKey"]
