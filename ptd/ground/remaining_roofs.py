"""Find roofs that are left in a terrain model, by the rule that takes roofs out of a cloud (`ptd.ground.plateaus`).

Between a roof and the ground beside it the model is interpolated: a ramp, which would join both. So where it is steep
nothing counts as ground, as there is none in the cloud.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from ptd.frame import Scale
from ptd.ground.morphology import EMPTY, Bool, Float64
from ptd.ground.plateaus import ROOF_CELL_M, ROOF_STEPS_M, Plateaus, plateaus

MAX_WIDTH_M = 240.0
"""The widest roof that is looked for."""
MILLIMETRES = Scale()


class RemainingRoof(NamedTuple):
    """A surface of the terrain that looks like a roof.

    Attributes
    ----------
    width_m : float
        Diameter of the largest circle inside, with its edge.
    row, column : float
        Its middle, cells.
    """

    width_m: float
    row: float
    column: float


def remaining_roofs(
    heights: Float64, cell_m: float = ROOF_CELL_M, min_width_m: float = 0.0
) -> list[RemainingRoof]:
    """Connected surfaces of a terrain model that lie above all that is seen around them.

    Nothing farther than `reach_m` has a part in whether a surface is found.

    Parameters
    ----------
    heights : float64, shape (rows, columns)
        Metres, NaN where unknown.
    cell_m : float
        Side of a cell.
    min_width_m : float
        Narrower ones are left out.
    """
    known = ~np.isnan(heights)
    if not known.any():
        return []
    counts, rises = np.full(heights.shape, EMPTY, np.int32), _rises(heights, known)
    counts[known] = np.rint(1000 * heights[known])
    found = np.zeros(heights.shape, np.bool_)
    for step_m in ROOF_STEPS_M:
        rule = Plateaus.of(MILLIMETRES, MAX_WIDTH_M, step_m, cell_m)
        ground = np.where(found | (rises > step_m), EMPTY, counts).astype(np.int32)
        found |= plateaus(ground, rule, found, known)
    numbers, _ = scipy.ndimage.label(found, np.ones((3, 3)))
    boxes = scipy.ndimage.find_objects(numbers)
    roofs = (_measured(numbers[box] == number, box, cell_m) for number, box in enumerate(boxes, start=1))
    return [roof for roof in roofs if roof.width_m >= min_width_m]


def _rises(heights: Float64, known: Bool) -> Float64:
    """The largest difference of each known height to those beside it."""
    highest = scipy.ndimage.maximum_filter(np.where(known, heights, -np.inf), 3)
    lowest = scipy.ndimage.minimum_filter(np.where(known, heights, np.inf), 3)
    rises: Float64 = np.maximum(highest - heights, heights - lowest)
    return rises


def _measured(piece: Bool, box: tuple[slice, ...], cell_m: float) -> RemainingRoof:
    """A roof from its cells, around which a row of its edge was too steep to be found."""
    depth = scipy.ndimage.distance_transform_edt(np.pad(piece, 1))
    row, column = ((side.start + side.stop) / 2 for side in box)
    return RemainingRoof(2 * (float(depth.max()) + 1) * cell_m, row, column)


def reach_m(cell_m: float = ROOF_CELL_M) -> float:
    """Metres beyond which nothing has a part in whether a cell is on a roof."""
    return (Plateaus.of(MILLIMETRES, MAX_WIDTH_M, cell_m=cell_m).reach + 1) * cell_m
