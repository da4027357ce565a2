"""Heights of cells on a TIN of ground cells, in facets that are not too wide, so that they have a fixed reach."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32
from ptd.frame import Scale
from ptd.ground.criteria import across
from ptd.ground.morphology import Bool
from ptd.kernel import as_int64, kernel
from ptd.tin.circles import Rule, facet_passes
from ptd.tin.interpolation import plane_height
from ptd.tin.layout import Int32Array
from ptd.tin.location import locate
from ptd.tin.mesh import Tin

MAX_WIDTH_M = 30.0
"""Largest circumradius of a facet that says where the ground is: a void of twice that is passed over."""
ANY_EDGE = 2**62
"""Square of an edge that none reaches."""

Float64 = npt.NDArray[np.float64]


def reach_m() -> float:
    """Metres beyond which nothing decides on a height.

    A facet is the untiled one if no vertex lies in its circle (`docs/filters.md`, Certificates); that ends within two
    of its radii from any place in it.
    """
    return 2.0 * MAX_WIDTH_M + 1.0


def ground_heights(x: Int32, y: Int32, z: Int32, ground: Bool, scale: Scale) -> Float64:
    """Height of the TIN of the ground cells at each cell: vertical counts, NaN where the facet is too wide.

    Parameters
    ----------
    x, y, z : int32 [n]
        Cells, local counts.
    ground : bool [n]
        Those that are vertices; their heights are their own.
    scale : Scale
    """
    tin = Tin.build(x[ground], y[ground], z[ground])
    found = np.full(x.size, np.nan)
    if tin.n_triangles:
        rule = Rule(ANY_EDGE, scale.counts(MAX_WIDTH_M))
        _between_vertices(tin.vertex_array, tin.triangle_array, x, y, rule, found)
    found[ground] = z[ground]
    return found


@kernel
def _between_vertices(
    vertices: Int32Array, triangles: Int32Array, x: Int32, y: Int32, rule: Rule, found: Float64
) -> None:
    """Heights off the vertices; on an edge the higher of its two facets' that count, as rounding tells them apart."""
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
