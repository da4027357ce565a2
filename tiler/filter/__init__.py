"""Filter: one pass of a method on one tile, core and halo, until its core carries no mark."""

from tiler.filter.tile import LABELS, filter_tile, sight_m

__all__ = ["LABELS", "filter_tile", "sight_m"]
