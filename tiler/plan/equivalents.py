"""Filters of other programs, and the methods that resemble them most."""

from __future__ import annotations

EQUIVALENTS = {
    "csf": "cloth simulation is not among the methods, but auto uses a stiffer cloth for photogrammetric clouds; ",
    "smrf": "the morphological filter SMRF is not among the methods, but chen2023 also uses stepwise openings; ",
    "pmf": "the morphological filter PMF is not among the methods, but chen2023 also uses stepwise openings; ",
    "ptd": "progressive TIN densification is --method classic; ",
    "mcc": "curvature filtering is not among the methods, but ridge2016 tests seeds against curved surfaces; ",
}
"""Beginning of the message about a filter of other programs, by the name of the filter in small
letters."""
