"""Filter: one pass of a method on one tile, core and halo, until its core carries no mark."""

from tiler.filter.tile import LABELS, filter_tile, local_window, sight_m
from tiler.filter.work import FilterTile

__all__ = ["LABELS", "FilterTile", "filter_tile", "local_window", "sight_m"]
