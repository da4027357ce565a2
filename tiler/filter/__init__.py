"""Filter: one pass of a method on one tile, core and halo, until its core carries no mark."""

from tiler.filter.tile import LABELS, filter_tile, influence_margin_m, local_window
from tiler.filter.work import FilterTile

__all__ = ["LABELS", "FilterTile", "filter_tile", "influence_margin_m", "local_window"]
