"""Heights of cells on a TIN of ground cells.

Facets that are too wide are ignored, so vertices beyond a fixed distance do not change a
height.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32
from ptd.frame import Scale
from ptd.ground.criteria import across
from ptd.ground.morphology import Bool
from ptd.kernel import as_int64, kernel
from ptd.tin.facets import Rule, facet_passes, plane_height
from ptd.tin.mesh import Tin
from ptd.tin.triangles import Int32Array, locate

MAX_CIRCUMRADIUS_M = 30.0
"""Largest circumradius of a facet that gives the height of the ground. Voids up to twice this
radius wide are spanned."""
ANY_EDGE = 2**62
"""Square of a length that no edge reaches."""

Float64 = npt.NDArray[np.float64]


def reach_m() -> float:
    """Return the distance in metres beyond which vertices do not change a height.

    A facet is the same as in an untiled run if no vertex of the whole cloud lies in its
    circumcircle (`docs/filters.md`, Certificates). No point of the circle is farther than two
    radii from a position in the facet.
    """
    return 2.0 * MAX_CIRCUMRADIUS_M + 1.0


def ground_heights(x: Int32, y: Int32, z: Int32, ground: Bool, scale: Scale) -> Float64:
    """Return the height of the TIN of the ground cells at each cell, in vertical counts: float64 [n].

    It is NaN where the facet is too wide.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of the cells.
    ground : bool [n]
        Mask of the ground cells, which are the vertices and keep their own heights.
    scale : Scale
    """
    tin = Tin.build(x[ground], y[ground], z[ground])
    heights = np.full(x.size, np.nan)
    if tin.n_triangles:
        rule = Rule(ANY_EDGE, scale.counts(MAX_CIRCUMRADIUS_M))
        _between_vertices(tin.vertex_array, tin.triangle_array, x, y, rule, heights)
    heights[ground] = z[ground]
    return heights


@kernel
def _between_vertices(
    vertices: Int32Array, triangles: Int32Array, x: Int32, y: Int32, rule: Rule, found: Float64
) -> None:
    """Interpolate the heights of cells into `found`.

    On an edge the heights on its two facets may differ by rounding. The higher one of facets
    that pass the rule counts.
    """
    t = as_int64(0)
    for i in range(x.size):
        px, py = as_int64(x[i]), as_int64(y[i])
        t = as_int64(locate(vertices, triangles, px, py, t))
        beside = across(vertices, triangles, t, px, py)
        for facet in (t, beside):
            if facet_passes(vertices, triangles, facet, rule):
                height = plane_height(vertices, triangles, facet, px, py, 1)
                if not found[i] >= height:
                    found[i] = height
