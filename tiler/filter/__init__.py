"""Filtering of tiles: a pass of a method runs on a core and a halo, which grows while labels are uncertified."""

from tiler.filter.tile import filter_tile, influence_margin_m, local_window
from tiler.filter.work import FilterTile

__all__ = ["FilterTile", "filter_tile", "influence_margin_m", "local_window"]
