"""Values of the mask, which is the source of the height of each pixel."""

from __future__ import annotations

OUTSIDE, MEASURED, INTERPOLATED, FILLED, HOLE, WATER, CANOPY = range(7)

MASK_VALUES = {
    OUTSIDE: "outside the survey",
    MEASURED: "measured: a ground point lies in the pixel",
    INTERPOLATED: "interpolated within the limit",
    FILLED: "filled beyond the limit",
    HOLE: "hole: no height inside the survey, or a tile that failed",
    WATER: "water: level, or falling along its flow",
    CANOPY: "canopy, bridged: crowns hide the ground",
}
