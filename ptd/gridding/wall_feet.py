"""Ground points at the foot of objects: remnants of walls and buildings in photogrammetric clouds.

Image matching leaves such points on walls. Without the buildings, they would stay in the
terrain as stumps.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, CellTable, Xyz, find_slot
from ptd.frame import CellLattice
from ptd.kernel import as_int64, kernel

Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]


@kernel
def _beside(
    ground: Xyz,
    cells: tuple[Int64, Int64],
    objects: Xyz,
    tops: Int32,
    table: CellTable,
    reach2: int,
    rise: int,
) -> npt.NDArray[np.bool_]:
    """Return whether a point of an object lies near each ground point and is higher by at least ``rise``.

    ``cells`` are the columns and rows of the ground points. Objects are sorted by cell. ``tops`` has the greatest
    height in each cell.
    """
    x, y, z = ground
    columns, rows = cells
    ox, oy, oz = objects
    slots, keys, starts, _order, width, height = table
    out = np.zeros(x.size, np.bool_)
    for i in range(x.size):
        for cell in range(9):
            slot = find_slot(
                slots, keys, width, height, columns[i] + cell % 3 - 1, rows[i] + cell // 3 - 1
            )
            if slot < 0 or as_int64(tops[slot]) - z[i] < rise:
                continue
            for k in range(starts[slot], starts[slot + 1]):
                dx, dy = as_int64(ox[k]) - x[i], as_int64(oy[k]) - y[i]
                if as_int64(oz[k]) - z[i] >= rise and dx * dx + dy * dy <= reach2:
                    out[i] = True
                    break
            if out[i]:
                break
    return out


def near_objects(
    ground: Int32, objects: Int32, reach: Fraction, rise: int, origin: tuple[int, int]
) -> npt.NDArray[np.bool_]:
    """Return a mask of the ground points with a point of an object within ``reach`` that is ``rise`` or more higher.

    Parameters
    ----------
    ground, objects : int32 [3, n], [3, m]
        Local counts.
    reach : Fraction
        Largest distance in plan, in horizontal counts.
    rise : int
        Least height difference in vertical counts.
    origin : tuple of int
        Absolute counts of the local 0.

    Returns
    -------
    bool [n]
    """
    if objects.shape[1] == 0 or ground.shape[1] == 0:
        return np.zeros(ground.shape[1], np.bool_)
    cells = CellLattice(max(math.ceil(reach), 1), 1, *origin)
    index = CellIndex(np.ascontiguousarray(objects[0]), np.ascontiguousarray(objects[1]), cells)
    above = Xyz(*(axis[index.table.order] for axis in objects))
    below = Xyz(*(np.ascontiguousarray(axis) for axis in ground))
    tops = np.maximum.reduceat(above.z, index.table.starts[:-1])
    cells_below = index.cell_indices(below.x, below.y)
    return _beside(
        below, cells_below, above, tops, index.table, math.floor(reach * reach), rise
    )
