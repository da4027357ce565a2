"""Rasters from a TIN: checked arguments around the kernels of `ptd.tin.raster` and `ptd.tin.natural`."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Int32, UInt8
from ptd.tin import natural, raster
from ptd.tin.facets import KnownBounds, Rule
from ptd.tin.mesh import MAX_EXTENT, Tin
from ptd.tin.raster import PixelCentres

_MAX_Q = 2**9 - 1
_ALL = 2**62  # exceeds the square of any edge


@dataclass(frozen=True)
class Pixels:
    """A block of pixels of the lattice anchored at absolute coordinate 0.

    The centre of pixel (row, column) of the block lies at x = (2 (left + column) + 1) p / (2 q)
    and y = (2 (top - row) + 1) p / (2 q) absolute counts: row 0 is the northern one.

    Parameters
    ----------
    p, q : int
        The cell size is p / q counts; q at most 511.
    left, top : int
        Global indices of the western column and of the northern row; the latter grow to the north.
    columns, rows : int
        Size of the block.
    origin_x, origin_y : int
        Absolute counts of the TIN's local 0.

    Raises
    ------
    ValueError
        If a size is out of range, or the block lies too far from the origin for exact arithmetic.
    """

    p: int
    q: int
    left: int
    top: int
    columns: int
    rows: int
    origin_x: int = 0
    origin_y: int = 0

    def __post_init__(self) -> None:
        if self.p < 1 or not 1 <= self.q <= _MAX_Q:
            raise ValueError(
                f"cell size is {self.p} / {self.q} counts, needs p >= 1 and 1 <= q <= {_MAX_Q}"
            )
        if self.columns < 0 or self.rows < 0:
            raise ValueError(
                f"block of {self.rows} rows and {self.columns} columns: none may be negative"
            )
        x0, y0, step, scale = self.lattice
        if step >= MAX_EXTENT * scale:
            raise ValueError(
                f"cell size is {self.p} / {self.q} counts, must be below {MAX_EXTENT}"
            )
        reach = max(
            abs(end) for end in (x0, y0, x0 + self.columns * step, y0 - self.rows * step)
        )
        if reach > 2**32 * scale:
            raise ValueError(
                f"pixels reach {reach // scale} counts from the TIN's local 0, {2**32} at most:"
                " give the TIN's origin_x and origin_y, or a smaller block"
            )

    @property
    def lattice(self) -> PixelCentres:
        """The pixel centres in local units of 1 / (2 q) count."""
        scale = 2 * self.q
        return PixelCentres(
            (2 * self.left + 1) * self.p - scale * self.origin_x,
            (2 * self.top + 1) * self.p - scale * self.origin_y,
            2 * self.p,
            scale,
        )


@dataclass(frozen=True)
class KnownWindow:
    """The half-open box, in local counts, in which all data are known, and its open sides.

    Beyond an open side there are no data at all.

    Raises
    ------
    ValueError
        If the box is empty.
    """

    west: int
    south: int
    east: int
    north: int
    open_west: bool = False
    open_south: bool = False
    open_east: bool = False
    open_north: bool = False

    def __post_init__(self) -> None:
        if self.west >= self.east or self.south >= self.north:
            raise ValueError(
                f"window x {self.west} .. {self.east}, y {self.south} .. {self.north} is empty (half-open)"
            )

    def sides(self) -> KnownBounds:
        """Inclusive limits of the known data, infinite on open sides."""
        return KnownBounds(
            -math.inf if self.open_west else float(self.west),
            -math.inf if self.open_south else float(self.south),
            math.inf if self.open_east else float(self.east - 1),
            math.inf if self.open_north else float(self.north - 1),
        )


EVERYWHERE = KnownWindow(
    0, 0, 1, 1, open_west=True, open_south=True, open_east=True, open_north=True
)


class TinRaster(NamedTuple):
    """Result of `rasterise`.

    Attributes
    ----------
    heights : float64 [rows, columns]
        Counts, NaN where no facet passes the rule.
    marks : bool [rows, columns]
        True where data outside the window could change the pixel.
    """

    heights: Float64
    marks: Bool


def _rule(max_edge: float, max_radius: float) -> Rule:
    for name, value in (("max_edge", max_edge), ("max_radius", max_radius)):
        if not value >= 0:
            raise ValueError(f"{name} is {value}, must be >= 0 counts")
    max_edge2 = math.floor(max_edge * max_edge) if max_edge < 2**31 else _ALL
    return Rule(max_edge2, float(max_radius))


def pixel_owners(
    tin: Tin,
    pixels: Pixels,
    *,
    max_edge: float = math.inf,
    max_radius: float = math.inf,
    window: KnownWindow = EVERYWHERE,
) -> tuple[Int32, UInt8]:
    """Find the facet or vertex that owns each pixel centre.

    Returns
    -------
    owners : int32 [rows, columns]
        Triangle number, -1 for none, -2 - v for vertex v.
    marks : uint8 [rows, columns]
        1 where data outside the window could change the pixel.

    Raises
    ------
    ValueError
        If a limit is negative or not a number.
    """
    rule = _rule(max_edge, max_radius)
    owners = np.empty((pixels.rows, pixels.columns), np.int32)
    marks = np.empty((pixels.rows, pixels.columns), np.uint8)
    arrays = (tin.vertex_array, tin.triangle_array, tin.counters)
    raster.scan(*arrays, owners, np.empty((0, 0)), marks, pixels.lattice, rule, window.sides())
    return owners, marks


def rasterise(
    tin: Tin,
    pixels: Pixels,
    *,
    max_edge: float = math.inf,
    max_radius: float = math.inf,
    window: KnownWindow = EVERYWHERE,
    interpolator: Literal["linear", "natural"] = "linear",
) -> TinRaster:
    """Interpolate heights at pixel centres over the facets that pass a rule.

    Parameters
    ----------
    tin : Tin
    pixels : Pixels
    max_edge : float
        Longest edge of a facet that is filled, counts.
    max_radius : float
        Largest circumradius of a facet that is filled, counts.
    window : KnownWindow
        The box in which all data are known; everywhere by default.
    interpolator : {"linear", "natural"}
        The plane of the facet, or Sibson's natural neighbours. Both fill the same pixels.

    Returns
    -------
    TinRaster

    Raises
    ------
    ValueError
        If the interpolator is unknown, a limit is negative or not a number.
    """
    if interpolator not in ("linear", "natural"):
        raise ValueError(f"interpolator is {interpolator!r}, must be 'linear' or 'natural'")
    if interpolator == "linear":
        heights = np.empty((pixels.rows, pixels.columns), np.float64)
        marks = np.empty((pixels.rows, pixels.columns), np.uint8)
        arrays = (tin.vertex_array, tin.triangle_array, tin.counters)
        rule = _rule(max_edge, max_radius)
        no_owners = np.empty((0, 0), np.int32)
        raster.scan(*arrays, no_owners, heights, marks, pixels.lattice, rule, window.sides())
    else:
        owners, marks = pixel_owners(
            tin, pixels, max_edge=max_edge, max_radius=max_radius, window=window
        )
        heights = natural.natural_heights(
            tin.vertex_array,
            tin.triangle_array,
            tin.counters,
            owners,
            marks,
            pixels.lattice,
            window.sides(),
        )
    return TinRaster(heights, marks.view(np.bool_))
