"""Comparison of a DTM with an earlier one of the same area: differences by class of land, and places of change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from ptd.arrays import Float64, Integer
from tiler.apps.check.accuracy import between_centres, pixel_places
from tiler.apps.difference_statistics import SpreadTally
from tiler.apps.evaluate.heights import (
    SLOPES_DEG,
    difference_writer,
    slopes_of,
    validate_targets,
)
from tiler.apps.evaluate.rasters import (
    blocks_with_files,
    crs_parts,
    horizontal_unit,
    open_raster,
    raster_beside,
    read_heights,
    vertical_unit,
)
from tiler.apps.results import Against, ChangeFigures, ChangePlace
from tiler.core.crs import same_horizontal
from tiler.core.products import MASK_VALUES, OUTSIDE
from tiler.core.units import unit_label
from tiler.errors import ConfigError
from tiler.io.locations import joined
from tiler.io.result_folder import read_run

CELL_PIXELS, MAX_CELLS = 4, 2048
"""Least side in pixels of the cells into which changes are collected, and largest number of cells along a side."""
LEAST_SHARE = 16
"""A cell belongs to a place if at least one of so many pixels changed. Otherwise noise would join places."""
MAX_PLACES = 100
"""Number of places that are listed, those with the largest volume of change."""

CHANGE_M = 0.5
"""Default of the least difference that is a change, metres."""


class AgainstOptions(NamedTuple):
    """Earlier DTM, least height of a change in metres, and the GeoTIFF that receives the differences, or None."""

    old: Path
    change_m: float
    difference: Path | None


def pixels_of(dtm: Path) -> int:
    """Return the number of pixels of a raster, or raise InputError if it cannot be read."""
    with open_raster(dtm) as raster:
        return int(raster.width * raster.height)


def compare(dtm: Path, options: AgainstOptions) -> Against:
    """Compare a DTM with an earlier one over the pixels that both have, as new minus old.

    The earlier DTM is interpolated bilinearly at the pixels of the new one, also from another pixel size or horizontal
    CRS. Its heights are converted to the unit of the new one. The rasters are read in blocks of bounded size.

    Parameters
    ----------
    dtm : Path
        The new DTM.
    options : AgainstOptions

    Raises
    ------
    InputError
        A raster cannot be read.
    ConfigError
        The new DTM has no square pixels along the axes of a projected CRS, the heights refer to different vertical
        datums, or the rasters do not overlap.
    ProcessingError
        The raster of differences cannot be written.
    """
    old, change_m, difference = options
    with ExitStack() as stack:
        new_raster = stack.enter_context(open_raster(dtm))
        old_raster = stack.enter_context(open_raster(old))
        _check_pixels(dtm, new_raster)
        _check_datums(dtm, new_raster, old, old_raster)
        move = _transformer(dtm, new_raster, old, old_raster)
        mask = _mask_beside(dtm, new_raster, stack)
        write = stack.enter_context(
            difference_writer(difference, new_raster, "DTM minus earlier DTM")
        )
        unit = vertical_unit(new_raster)
        tally = _Tally(new_raster, change_m / float(unit))
        factor = float(vertical_unit(old_raster) / unit)
        for row, col, height, width in blocks_with_files(
            new_raster, *([] if move else [old_raster])
        ):
            window = row, col, height, width
            new_heights = read_heights(new_raster, *window)
            old_heights = factor * _heights_on(new_raster, window, old_raster, move)
            lies_in = None if mask is None else np.nan_to_num(read_heights(mask, *window))
            tally.add(row, col, new_heights, old_heights, lies_in)
            if write is not None:
                write(new_heights - old_heights, row, col)
        if not tally.all.n:
            raise ConfigError(
                f"{dtm} and {old} have no pixel with heights in common; give a DTM of the same area"
            )
        places = tally.places()
        notes = _notes(dtm, new_raster, old, old_raster, move)
    return {
        "old": str(old),
        "unit": unit_label(unit),
        "metres_per_unit": float(unit),
        "change_m": change_m,
        "only_new": tally.only_new,
        "only_old": tally.only_old,
        "changed_pixels": tally.changed,
        "all": tally.figures(tally.all),
        "by_slope": {
            name: tally.figures(found) for name, found in tally.by_slope.items() if found.n
        },
        "by_source": {
            name: tally.figures(found) for name, found in tally.by_source.items() if found.n
        },
        "scattered_pixels": tally.changed - sum(place["pixels"] for place in places),
        "places": places[:MAX_PLACES],
        "number_of_places": len(places),
        "difference": None if difference is None else str(difference),
        "notes": notes,
    }


def validate_difference(dtm: Path, options: AgainstOptions) -> None:
    """Raise ConfigError if the raster of differences would replace a file that is read, or a result of a run."""
    old, change_m, difference = options
    if not change_m > 0:
        raise ConfigError(f"--change {change_m:g}: must be above 0")
    if difference is None:
        return
    results = [
        joined(str(raster.parent), name)
        for raster in (dtm, old)
        for name in (read_run(str(raster.parent)) or {}).get("outputs", ())
    ]
    validate_targets(difference, None, (), results, (dtm, old))


def _check_pixels(dtm: Path, raster: Any) -> None:
    """Raise ConfigError if areas and slopes of a raster cannot be measured."""
    t = raster.transform
    if raster.crs and raster.crs.is_geographic:
        raise ConfigError(f"{dtm} is in degrees; bring it into a projected CRS (gdalwarp)")
    if t.b or t.d or not math.isclose(abs(t.a), abs(t.e), rel_tol=1e-6):
        raise ConfigError(
            f"{dtm} has pixels that are rotated or not square; give a DTM with square pixels along the axes"
        )


def _mask_beside(dtm: Path, raster: Any, stack: ExitStack) -> Any | None:
    """Return the open mask of a run's DTM, or None if there is none on the same pixels."""
    path = raster_beside(dtm, "mask")
    mask = None if path is None else stack.enter_context(open_raster(path))
    same = mask is not None and (mask.shape, mask.transform) == (raster.shape, raster.transform)
    return mask if same else None


def _check_datums(dtm: Path, new: Any, old_path: Path, old: Any) -> None:
    """Raise ConfigError if both rasters state a vertical datum and these differ."""
    one, other = (crs_parts(raster)[1] for raster in (new, old))
    if one is not None and other is not None and _datum(one) != _datum(other):
        raise ConfigError(
            f"{dtm} has heights of {one.name}, {old_path} of {other.name}; convert one of them "
            "(gdalwarp with both vertical CRS)"
        )


def _datum(crs: CRS) -> tuple[bool, str | None]:
    """Return whether heights are above an ellipsoid, and the name of their datum. Units do not matter."""
    return not crs.is_vertical, crs.datum.name if crs.datum else None


def _notes(
    dtm: Path, new: Any, old_path: Path, old: Any, move: Transformer | None
) -> list[str]:
    notes = []
    without = [str(path) for path, raster in ((dtm, new), (old_path, old)) if not raster.crs]
    if without:
        notes.append(
            f"{' and '.join(without)} without a CRS: assumed to be the same as that of the other DTM"
        )
    elif (crs_parts(new)[1] is None) != (crs_parts(old)[1] is None):
        path = dtm if crs_parts(new)[1] is None else old_path
        notes.append(
            f"{path} has no vertical datum: assumed to be the same as that of the other DTM"
        )
    if move is not None:
        notes.append(
            "the earlier DTM is in another CRS: its positions were transformed, its heights are as they are"
        )
    return notes


def _transformer(dtm: Path, new: Any, old_path: Path, old: Any) -> Transformer | None:
    """Return the transformation into the horizontal CRS of the earlier DTM, or None if it is the same or not known."""
    source, target = (crs_parts(raster)[0] for raster in (new, old))
    if source is None or target is None or same_horizontal(source, target):
        return None
    try:
        return Transformer.from_crs(source, target, always_xy=True)
    except ProjError as error:
        raise ConfigError(
            f"{dtm} is in {source.name}, which cannot be transformed to {target.name} of {old_path}; "
            "bring both into one CRS (gdalwarp)"
        ) from error


def _heights_on(
    new: Any, window: tuple[int, int, int, int], old: Any, move: Transformer | None
) -> Float64:
    """Return the earlier heights at the pixel centres of a window of the new DTM.

    The window is row, column, height and width.
    """
    row, col, height, width = window
    cols, rows = np.meshgrid(col + np.arange(width) + 0.5, row + np.arange(height) + 0.5)
    t = new.transform
    x, y = t.a * cols + t.b * rows + t.c, t.d * cols + t.e * rows + t.f
    if move is not None:
        x, y = move.transform(x, y)
    return between_centres(old, *pixel_places(old.transform, x, y))


class _Tally:
    """Counts of the changes of blocks, by slope and by the source of the new height, and sums of changes in cells."""

    def __init__(self, raster: Any, change: float) -> None:
        height, width = raster.shape
        self._transform = raster.transform
        self._pixel = float(abs(raster.transform.a) * horizontal_unit(raster))
        self._to_m = float(vertical_unit(raster))
        self._step = self._pixel / self._to_m
        self._change = change
        self._side = max(CELL_PIXELS, -(-max(height, width) // MAX_CELLS))
        cells = -(-height // self._side), -(-width // self._side)
        self._counts, self._sums = np.zeros(cells, np.int32), np.zeros(cells)
        self._volumes, self._largest = np.zeros(cells), np.zeros(cells)
        # First and last row and column of the changed pixels in each cell.
        self._first, self._last = np.full((2, *cells), 1 << 30), np.full((2, *cells), -1)
        self.only_new, self.only_old, self.changed = 0, 0, 0
        self.all = SpreadTally()
        edges = pairwise(SLOPES_DEG)
        self.by_slope = {f"{low} to {high} degrees": SpreadTally() for low, high in edges}
        self.by_source = {name: SpreadTally() for name in MASK_VALUES.values()}

    def add(
        self, row: int, col: int, heights: Float64, old: Float64, source: Float64 | None
    ) -> None:
        """Count a block whose first pixel is (row, col). ``source`` has values of the mask."""
        changes = heights - old
        known = np.isfinite(changes)
        self.only_new += int(np.count_nonzero(np.isfinite(heights) & ~known))
        self.only_old += int(np.count_nonzero(np.isfinite(old) & ~known))
        values = changes[known]
        self.all.add(values)
        slopes = slopes_of(heights, self._step)[known]
        for k, found in enumerate(self.by_slope.values()):
            found.add(
                values[
                    (slopes >= SLOPES_DEG[k])
                    & ((slopes < SLOPES_DEG[k + 1]) | (k == len(self.by_slope) - 1))
                ]
            )
        if source is not None:
            for value, name in MASK_VALUES.items():
                if value != OUTSIDE:
                    self.by_source[name].add(values[source[known] == value])
        rows, cols = np.nonzero(known & (np.abs(np.nan_to_num(changes)) >= self._change))
        large = changes[rows, cols]
        self.changed += large.size
        at = rows + row, cols + col
        cells = at[0] // self._side, at[1] // self._side
        for axis in (0, 1):
            np.minimum.at(self._first[axis], cells, at[axis])
            np.maximum.at(self._last[axis], cells, at[axis])
        np.add.at(self._counts, cells, 1)
        np.add.at(self._sums, cells, large)
        np.add.at(self._volumes, cells, np.abs(large))
        np.maximum.at(self._largest, cells, np.abs(large))

    @staticmethod
    def figures(found: SpreadTally) -> ChangeFigures:
        """Return the number of pixels and the statistics of their changes."""
        return {"pixels": found.n, **found.summary()}

    def places(self) -> list[ChangePlace]:
        """Return the places of change, connected cells with changed pixels, the largest volume first."""
        labels, _ = scipy.ndimage.label(
            self._counts >= max(self._side**2 // LEAST_SHARE, 1), np.ones((3, 3))
        )
        return sorted(
            self._places(labels), key=lambda place: (-place["volume_m3"], place["bounds"])
        )

    def _places(self, labels: Integer) -> Iterator[ChangePlace]:
        t, pixel_m2 = self._transform, self._pixel**2
        for number, box in enumerate(scipy.ndimage.find_objects(labels), 1):
            inside = labels[box] == number
            pixels = int(self._counts[box][inside].sum())
            top, left = self._first[:, *box][:, inside].min(axis=1).tolist()
            bottom, right = (self._last[:, *box][:, inside].max(axis=1) + 1).tolist()
            x = t.c + left * t.a, t.c + right * t.a
            y = t.f + top * t.e, t.f + bottom * t.e
            yield {
                "bounds": [min(x), min(y), max(x), max(y)],
                "pixels": pixels,
                "area_m2": pixels * pixel_m2,
                "mean_m": float(self._sums[box][inside].sum() / pixels) * self._to_m,
                "largest_m": float(self._largest[box][inside].max()) * self._to_m,
                "volume_m3": float(self._volumes[box][inside].sum()) * self._to_m * pixel_m2,
            }
