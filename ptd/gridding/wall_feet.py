"""Ground points at the foot of objects: what image matching leaves of walls, the stumps of removed buildings."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, CellTable, slot_of
from ptd.frame import Cells
from ptd.kernel import kernel, wide

Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]


@kernel
def _beside(
    x: Int32, y: Int32, z: Int32, columns: Int64, rows: Int64, ox: Int32, oy: Int32, oz: Int32, table: CellTable,
    reach2: int, rise: int,
) -> npt.NDArray[np.bool_]:  # fmt: skip
    """Whether an object's point lies near each point and higher by ``rise``."""
    out = np.zeros(x.size, np.bool_)
    for i in range(x.size):
        for cell in range(9):
            slot = slot_of(table, columns[i] + cell % 3 - 1, rows[i] + cell // 3 - 1)
            if slot < 0:
                continue
            for j in range(table.starts[slot], table.starts[slot + 1]):
                k = table.order[j]
                dx, dy = wide(ox[k]) - x[i], wide(oy[k]) - y[i]
                if wide(oz[k]) - z[i] >= rise and dx * dx + dy * dy <= reach2:
                    out[i] = True
                    break
            if out[i]:
                break
    return out


def beside_objects(
    ground: Int32, objects: Int32, reach: Fraction, rise: int, origin: tuple[int, int]
) -> npt.NDArray[np.bool_]:
    """Ground points within ``reach`` in plan of an object's point that is at least ``rise`` higher.

    Parameters
    ----------
    ground, objects : int32 [3, n], [3, m]
        Local counts.
    reach : Fraction
        Counts.
    rise : int
        Vertical counts.
    origin : tuple of int
        Absolute counts of the local 0.

    Returns
    -------
    bool [n]
    """
    if objects.shape[1] == 0 or ground.shape[1] == 0:
        return np.zeros(ground.shape[1], np.bool_)
    cells = Cells(reach.numerator, reach.denominator, *origin)
    x, y, z = (np.ascontiguousarray(axis) for axis in objects)
    index = CellIndex(x, y, cells)
    gx, gy, gz = (np.ascontiguousarray(axis) for axis in ground)
    reach2 = math.floor(reach * reach)
    return _beside(gx, gy, gz, *index.places(gx, gy), x, y, z, index.table, reach2, rise)
