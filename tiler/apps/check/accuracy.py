"""Accuracy of a DTM at checkpoints.

It follows the ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2 (2023,
version 2 of 2024). Accuracy is the RMSE, without a factor for 95 % confidence, and includes the
checkpoints' own error. A statement needs at least 30 checkpoints (more above 1000 km2, 120 at
most), their types and their own error, and no constant offset of the heights. Vegetated accuracy
(VVA) is reported and never judged.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from ptd.arrays import Bool, Float64
from tiler.apps.check.points import NVA, VVA, Checkpoints, PointOptions
from tiler.apps.difference_statistics import spread
from tiler.apps.evaluate.rasters import (
    horizontal_unit,
    open_raster,
    read_heights,
    vertical_unit,
)
from tiler.apps.results import Accuracy, AccuracyFigures, CheckedPoint, Statement
from tiler.core.crs import same_horizontal, split
from tiler.core.units import short_unit, unit_label
from tiler.errors import ConfigError
from tiler.io.foreign_content import excerpt

STANDARD = "ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2"
MIN_POINTS = 30
"""Minimum number of checkpoints that the standard requires."""
MAX_POINTS = 120
"""Number of checkpoints that the standard requires for the largest areas."""
OUTLIER_NMADS = 3.0
"""Minimum distance of an outlier from the median, in NMAD.

Outliers are listed and stay in all statistics.
"""
MIN_OFFSET_M = 1.0
"""Minimum median of the differences that counts as a constant offset, in metres.

A DTM whose typical checkpoint is off by more is not usable, while geoid heights, other vertical
datums and feet read as metres differ by metres to hundreds of metres.
"""
OFFSET_NMADS = 10.0
"""Minimum median of the differences that counts as a constant offset, in NMAD.

Errors of a terrain model vary from place to place, so their NMAD is of the order of their median.
Only a shift of all heights moves the median by many NMAD.
"""
MIN_OFFSET_POINTS = 3
"""Minimum number of checkpoints that show a constant offset. Two blunders may agree by chance."""
MAX_WINDOW = 1 << 22
"""Largest number of pixels that are read at once to interpolate heights."""
_ROUNDING = 1e-9


def check_dtm(
    dtm: Path | str, points: Checkpoints, options: PointOptions | None = None
) -> Accuracy:
    """Compare a DTM, interpolated bilinearly between pixel centres, with checkpoints.

    Raises
    ------
    InputError
        The DTM cannot be read.
    ConfigError
        The CRS of the checkpoints is unknown or cannot be transformed to the CRS of the DTM, or the DTM has no height
        at any checkpoint.
    """
    options = options or PointOptions()
    notes = list(points.notes)
    with open_raster(dtm) as raster:
        metres = vertical_unit(raster)
        x, y = _in_crs_of(raster, points, options, notes)
        sampled, outside = bilinear(raster, x, y)
        if np.isnan(sampled).all():
            raise ConfigError(f"{dtm}: {_why_no_height(raster, points, options, outside)}")
        area_km2 = _area_km2(raster)
    z = points.z * float((options.unit or metres) / metres)
    difference = sampled - z
    own_error = options.rmse / float(metres)
    if not own_error:
        notes.append(
            "the checkpoints' own error is assumed to be 0; give it with --points-rmse"
        )
    kinds, covers = np.array(points.kinds), np.array(points.covers)
    nva, vva = (_figures(difference[kinds == kind], own_error) for kind in (NVA, VVA))
    every = _figures(difference, own_error)
    offset = _offset_text(every, metres)
    return {
        "dtm": str(dtm),
        "unit": unit_label(metres),
        "metres_per_unit": float(metres),
        "points": len(points),
        "used": int(np.isfinite(difference).sum()),
        "outside": int(outside.sum()),
        "no_height": int((np.isnan(sampled) & ~outside).sum()),
        "points_rmse": own_error,
        "all": every,
        "nva": nva,
        "vva": vva,
        "land_cover": {
            n: _figures(difference[covers == n], own_error)
            for n in sorted(set(points.covers))
            if n
        },
        "constant_offset": offset,
        "asprs": _statement(
            nva, vva, area_km2, float(metres), _missing(points, own_error, offset)
        ),
        "differences": _checked_points(points, (x, y, z), sampled, difference),
        "notes": notes,
    }


def _why_no_height(
    raster: Any, points: Checkpoints, options: PointOptions, outside: Bool
) -> str:
    """Return why the DTM has no height at any checkpoint, and a remedy."""
    none = f"none of the checkpoints ({len(points):,})"
    if not outside.all():
        return (
            f"{none} has a height of the DTM: {outside.sum()} outside, {(~outside).sum()} at nodata pixels; "
            "give checkpoints where the DTM has heights"
        )
    swapped = replace(points, xy=points.xy[::-1])
    n_inside = int((~bilinear(raster, *_in_crs_of(raster, swapped, options, []))[1]).sum())
    if n_inside:
        return (
            f"{none} is inside the DTM, but {n_inside:,} would be with x and y swapped; "
            "swap the columns or their names (x is east, y is north)"
        )
    return f"{none} is inside the DTM; give their CRS with --points-crs, or check their x and y"


def _checked_points(
    points: Checkpoints,
    xyz: tuple[Float64, Float64, Float64],
    sampled: Float64,
    difference: Float64,
) -> list[CheckedPoint]:
    x, y, z = (values.tolist() for values in xyz)
    columns = (
        points.names, x, y, points.kinds, points.covers, z,
        _none_for_nan(sampled), _none_for_nan(difference), outliers(difference).tolist(),
    )  # fmt: skip
    return [
        CheckedPoint(
            name=name,
            x=x,
            y=y,
            kind=kind,
            cover=cover,
            z=z,
            dtm=dtm,
            difference=d,
            outlier=is_outlier,
        )
        for name, x, y, kind, cover, z, dtm, d, is_outlier in zip(*columns, strict=True)
    ]


def _none_for_nan(values: Float64) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _in_crs_of(
    raster: Any, points: Checkpoints, options: PointOptions, notes: list[str]
) -> tuple[Float64, Float64]:
    """Return x and y of the checkpoints in the raster's CRS. Heights are not transformed."""
    text = options.crs or points.crs
    x, y = points.xy
    if text is None:
        notes.append(
            "the checkpoints have no CRS: it is assumed to be that of the DTM; use --points-crs if it is not"
        )
        return x, y
    if raster.crs is None:
        raise ConfigError(
            f"the checkpoints are in {excerpt(text)}, the DTM has no CRS; assign its CRS to the DTM, or give "
            "checkpoints without a CRS (no --points-crs) if it is the same"
        )
    try:
        named = CRS.from_user_input(text)
        raster_crs = CRS.from_wkt(raster.crs.to_wkt())
    except (ProjError, UnicodeError, RecursionError) as error:
        raise ConfigError(
            f"the checkpoints are in {excerpt(text)}, which is not a known CRS; give one with --points-crs"
        ) from error
    source, target = split(named)[0], split(raster_crs)[0]
    if source is None or target is None:
        raise ConfigError(
            f"{text}: has no horizontal part; give the CRS of x and y with --points-crs"
        )
    if same_horizontal(source, target):
        return x, y
    notes.append(
        f"x and y of the checkpoints brought from {source.name} into {target.name}; heights are as they are"
    )
    try:
        moved = Transformer.from_crs(source, target, always_xy=True).transform(x, y)
    except ProjError as error:
        raise ConfigError(
            f"the checkpoints are in {source.name}, which cannot be transformed to {target.name}; "
            "give another CRS with --points-crs"
        ) from error
    return np.asarray(moved[0], np.float64), np.asarray(moved[1], np.float64)


def bilinear(raster: Any, x: Float64, y: Float64) -> tuple[Float64, Bool]:
    """Return heights at positions, interpolated bilinearly between the four pixel centres around each.

    Parameters
    ----------
    raster : rasterio data set
    x, y : float64 [n]
        Positions in the raster's CRS.

    Returns
    -------
    heights : float64 [n]
        Heights, or NaN if a pixel of non-zero weight has no data or does not exist.
    outside : bool [n]
        Mask of the positions that lie beyond the raster's pixels.
    """
    columns, rows = pixel_places(raster.transform, x, y)
    outside = ~(
        (columns >= 0) & (columns <= raster.width) & (rows >= 0) & (rows <= raster.height)
    )
    heights = np.full(x.size, np.nan)
    for i in np.flatnonzero(~outside):  # They may be far apart.
        heights[i] = between_centres(raster, columns[i : i + 1], rows[i : i + 1])[0]
    return heights, outside


def pixel_places(transform: Any, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Return positions as columns and rows, in pixels from the outer corner of the first pixel.

    ``transform`` is the affine transform of a rasterio data set.
    """
    a, b, c, d, e, f = tuple(transform)[:6]
    determinant = a * e - b * d
    across, down = np.asarray(x) - c, np.asarray(y) - f
    # A failed transformation gives infinity, which is beyond all pixels.
    with np.errstate(invalid="ignore"):
        return (e * across - b * down) / determinant, (a * down - d * across) / determinant


def between_centres(raster: Any, columns: Float64, rows: Float64) -> Float64:
    """Return heights, interpolated bilinearly, at places in pixels from the outer corner of the first pixel.

    Arrays have any shape. Heights are NaN if a pixel of non-zero weight has no data. Places that would need a window of
    more than `MAX_WINDOW` pixels are divided.
    """
    # An integer is meant if only rounding separates a place from it.
    down, across = (
        np.where(np.abs(places - np.rint(places)) < 1e-6, np.rint(places), places)
        for places in (rows - 0.5, columns - 0.5)
    )
    heights = np.full(rows.shape, np.nan)
    # A failed transformation gives infinity.
    inside = (down > -1) & (down < raster.height) & (across > -1) & (across < raster.width)
    if not inside.any():
        return heights
    down, across = down[inside], across[inside]
    corner = [math.floor(places.min()) for places in (down, across)]
    size = [
        math.floor(places.max()) + 2 - first
        for places, first in zip((down, across), corner, strict=True)
    ]
    if size[0] * size[1] > MAX_WINDOW and heights.size > 1:
        axis = int(np.argmax(heights.shape))
        halves = zip(
            np.array_split(columns, 2, axis), np.array_split(rows, 2, axis), strict=True
        )
        return np.concatenate([between_centres(raster, *half) for half in halves], axis)
    read = read_heights(raster, *corner, *size)
    top, left = np.floor(down).astype(int), np.floor(across).astype(int)
    down, across = down - top, across - left
    top, left = top - corner[0], left - corner[1]
    total = np.zeros(top.size)
    for below, by_row in ((0, 1 - down), (1, down)):
        for right, by_col in ((0, 1 - across), (1, across)):
            weight = by_row * by_col
            total += np.where(weight > 0, weight * read[top + below, left + right], 0.0)
    heights[inside] = total
    return heights


def outliers(difference: Float64) -> Bool:
    """Return a mask of the differences that lie farther than `OUTLIER_NMADS` from their median.

    A difference of NaN is not an outlier.
    """
    figures = spread(difference[np.isfinite(difference)])
    if figures["median"] is None or figures["nmad"] is None:
        return np.zeros(difference.size, np.bool_)
    limit = OUTLIER_NMADS * figures["nmad"] + _ROUNDING
    is_outlier: Bool = np.abs(difference - figures["median"]) > limit
    return is_outlier


def _figures(difference: Float64, own_rmse: float) -> AccuracyFigures:
    """Return the statistics of the differences that are not NaN, and the accuracy by the standard."""
    used = difference[np.isfinite(difference)]
    figures = spread(used)
    rmse = figures["rmse"]
    return {
        "points": int(used.size),
        **figures,
        "rmse_v": None if rmse is None else math.hypot(rmse, own_rmse),
        "outliers": int(outliers(used).sum()),
    }


def min_points(area_km2: float) -> int:
    """Return the number of checkpoints that the standard requires.

    It is 30 up to 1000 km2, plus 10 for each further 1000 km2 or part of it, up to 120.
    """
    further = max(math.ceil(min(area_km2, 1e9) / 1000) - 1, 0)
    return min(MIN_POINTS + 10 * further, MAX_POINTS)


def _area_km2(raster: Any) -> float:
    """Return the area of the whole raster, including pixels without data."""
    pixel = abs(float(raster.transform.determinant)) * float(horizontal_unit(raster)) ** 2
    return pixel * int(raster.width) * int(raster.height) / 1e6


def _offset_text(figures: AccuracyFigures, metres: Fraction) -> str | None:
    """Return a sentence about the constant offset of the heights, or None if there is none."""
    median, nmad = figures["median"], figures["nmad"]
    if median is None or nmad is None or figures["points"] < MIN_OFFSET_POINTS:
        return None
    if abs(median) <= max(MIN_OFFSET_M / float(metres), OFFSET_NMADS * nmad):
        return None
    return (
        f"constant offset of {median:+.1f} {short_unit(metres)} (median; NMAD {nmad:.3f}): another vertical datum or "
        "unit? Convert the heights of the checkpoints to the datum of the DTM, or give their unit with --points-unit"
    )


def _missing(points: Checkpoints, own_error: float, offset: str | None) -> list[str]:
    """Return what a statement lacks besides checkpoints, with remedies."""
    lacks = {
        "the heights have a constant offset": offset is not None,
        "give the type of each checkpoint (NVA or VVA) in a column `type`": not points.has_types,
        # No survey is without error, so 0 means that the error is not known.
        "give the checkpoints' own RMSE with --points-rmse": not own_error,
    }
    return [text for text, is_missing in lacks.items() if is_missing]


def _statement(
    nva: AccuracyFigures,
    vva: AccuracyFigures,
    area_km2: float,
    metres: float,
    missing: list[str],
) -> Statement:
    """Return the accuracy statement of the standard from the figures of NVA and VVA checkpoints.

    ``missing`` lists what else the statement lacks.
    """
    needed = min_points(area_km2)
    enough = nva["points"] >= needed
    if not enough:
        few = f"{nva['points']} NVA checkpoints, at least {needed} are needed"
        missing = [few, *missing]
    text = None
    if not missing and nva["rmse_v"] is not None:
        text = (
            f"Tested by the {STANDARD} (2024): the actual NVA accuracy was found to be "
            f"RMSEV = {100 * metres * nva['rmse_v']:.1f} cm with {nva['points']} checkpoints"
        )
        if vva["rmse_v"] is not None:
            text += f", the actual VVA accuracy RMSEV = {100 * metres * vva['rmse_v']:.1f} cm with {vva['points']}"
        text += "."
    return {
        "standard": STANDARD,
        "least_points": needed,
        "enough_points": enough,
        "missing": missing,
        "statement": text,
    }
