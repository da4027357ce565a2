"""Filtering of tiles: a pass of a method runs on a core and a halo, which grows while labels are uncertified."""
