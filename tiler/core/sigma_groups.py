"""Groups of ground and classes of the standard error in run.json and the report."""

from __future__ import annotations

OPEN, COVERED, WET = "open", "covered", "water"
GROUPS = (OPEN, COVERED, WET)
COVERED_SHARE = 0.5
"""Minimum share of objects among the points around covered ground. Filled pixels and canopy are
covered, too."""
EDGES_M = (0.0, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
"""Edges of the classes of the standard error, in metres."""
