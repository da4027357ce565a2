"""Seeds of a town that lie on podiums or lower roofs.

Source: Dong 2017 (004), section 3.1, step 4, and equation 1.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, CellTable, Int32, Int64, Xyz, slot_of
from ptd.frame import CellLattice, Scale
from ptd.kernel import kernel

Bool = npt.NDArray[np.bool_]

NOISE_QUANTILE = 1.65
"""One-sided 95 % quantile in equation 1 for a difference of two heights, which varies by
sqrt(2) sigma."""


@kernel
def _too_high(
    points: Xyz,
    table: CellTable,
    cells: tuple[Int64, Int64],
    radius: float,
    slope: float,
    noise: float,
    z_ratio: float,
) -> Bool:
    x, y, z = points
    columns, rows = cells
    out = np.zeros(x.size, np.bool_)
    for i in range(x.size):
        for row in range(rows[i] - 1, rows[i] + 2):
            for column in range(columns[i] - 1, columns[i] + 2):
                slot = slot_of(table, column, row)
                if slot < 0:
                    continue
                for k in range(table.starts[slot], table.starts[slot + 1]):
                    j = table.order[k]
                    dx, dy = float(x[j] - x[i]), float(y[j] - y[i])
                    apart = math.sqrt(dx * dx + dy * dy)
                    above = (float(z[i]) - float(z[j])) * z_ratio
                    if apart <= radius and above > slope * apart + noise:
                        out[i] = True
    return out


def on_podium(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, slope: float, sigma_m: float
) -> Bool:
    """Seeds that lie on a podium or a lower roof: too high above another seed nearby (004, 3.1, step 4).

    The paper keeps the lower of any two seeds in a neighbourhood, which would leave only the lowest seed on a hillside.
    Here the upper seed also has to be higher than ground can be at its distance d by the paper's equation 1,
    ``0.3 d + 1.65 sqrt(2) sigma``. All seeds are judged against all and dropped together, so order does not matter.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of seeds.
    radius_m : float
        Radius of the neighbourhood, metres.
    slope : float
        Largest slope of ground, metres per metre.
    sigma_m : float

    Returns
    -------
    bool [n]
    """
    if x.size == 0:
        return np.zeros(0, np.bool_)
    index = CellIndex(x, y, CellLattice.of(radius_m, scale))
    noise = NOISE_QUANTILE * math.sqrt(2.0) * scale.counts(sigma_m)
    cells, radius = index.cell_indices(x, y), scale.counts(radius_m)
    return _too_high(Xyz(x, y, z), index.table, cells, radius, slope, noise, scale.z_ratio)
