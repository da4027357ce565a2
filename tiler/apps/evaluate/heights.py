"""Comparison of a DTM with a reference raster, and of its standard errors with its actual errors, block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyproj import CRS

from ptd.arrays import Float64, Int64
from ptd.gridding.shape import gradients, slope_deg
from tiler.apps.difference_statistics import SpreadTally
from tiler.apps.evaluate.clouds import ratio
from tiler.apps.evaluate.maps import validate_map_files
from tiler.apps.evaluate.rasters import (
    blocks_with_files,
    files_of_raster,
    horizontal_unit,
    open_raster,
    read_heights,
    vertical_unit,
)
from tiler.apps.results import DtmScores, SigmaFigures, SigmaReport, SigmaScores, SlopeFigures
from tiler.core.crs import same_horizontal, split
from tiler.core.raster import NODATA
from tiler.core.units import unit_label
from tiler.errors import ConfigError
from tiler.io.atomic_files import atomic_path
from tiler.io.overwrite_check import Target, check_difference, check_targets
from tiler.io.raster_files import RasterMetadata, plain_geotiff, raster_errors

SLOPES_DEG = (0, 5, 15, 30, 90)
"""Edges of the classes of slope, degrees."""
PER_DECADE = 100
"""Number of classes of standard errors and errors per factor of ten.

Values in a class are not ordered.
"""
LOWEST, HIGHEST = -5.0, 4.0
"""Decimal logarithms of the lowest and the highest class, in units of the heights."""
LOOKED_AT = 0.1
"""Share of the area that a person may inspect."""

N_CLASSES = round((HIGHEST - LOWEST) * PER_DECADE) + 1


class Pair(NamedTuple):
    """Two open rasters on one lattice. The DTM's pixel (0, 0) is the reference's pixel (row, col)."""

    dtm: Any
    truth: Any
    row: int
    col: int


def evaluate_dtm(
    dtm: Path | str,
    truth: Path | str,
    difference: Path | str | None = None,
    sigma: Path | str | None = None,
) -> DtmScores:
    """Compare a DTM with a reference over the pixels that both have, as ``dtm - truth``.

    The rasters are read in blocks of bounded size, whatever their extent.

    Parameters
    ----------
    dtm, truth : path
        Rasters of the same CRS, unit and pixel size on the same pixel lattice, the second one is the reference. Their
        first bands are compared. Extents may differ.
    difference : path, optional
        GeoTIFF that receives the differences, float32, on the reference's pixels.
    sigma : path, optional
        Raster of the DTM's standard errors, which are compared with its actual errors.

    Raises
    ------
    InputError
        A raster cannot be read.
    ConfigError
        The rasters differ in CRS or units, do not lie on one lattice, or do not overlap. Or ``difference`` would
        replace one of them, or does not have the suffix of a GeoTIFF.
    ProcessingError
        ``difference`` cannot be written.
    """
    validate_targets(difference, None, (), (), (dtm, truth))
    tally, both, only_dtm, only_truth = SpreadTally(), 0, 0, 0
    with ExitStack() as stack:
        pair = stack.enter_context(_opened(Path(dtm), Path(truth)))
        write = stack.enter_context(
            difference_writer(difference, pair.truth, "DTM minus truth")
        )
        unit = unit_label(vertical_unit(pair.truth))
        judge = (
            None
            if sigma is None
            else _Judge(stack.enter_context(_opened(Path(sigma), Path(truth))))
        )
        for row, col, height, width in blocks_with_files(pair.truth, pair.dtm):
            dtm_heights = read_heights(pair.dtm, row - pair.row, col - pair.col, height, width)
            true = read_heights(pair.truth, row, col, height, width)
            has_mine, has_true = np.isfinite(dtm_heights), np.isfinite(true)
            common = has_mine & has_true
            both += int(common.sum())
            only_dtm += int((has_mine & ~common).sum())
            only_truth += int((has_true & ~common).sum())
            tally.add(dtm_heights[common] - true[common])
            if write is not None:
                write(dtm_heights - true, row, col)
            if judge is not None:
                judge.add(row, col, dtm_heights, true)
    judged: SigmaScores = (
        {} if judge is None else {"sigma": judge.tally.summary(), "sigma_file": str(sigma)}
    )
    return {
        "unit": unit,
        "pixels": both,
        "only_dtm": only_dtm,
        "only_truth": only_truth,
        "coverage": ratio(both, both + only_truth),
        **tally.summary(),
        "quantile_step": tally.step,
        **judged,
    }


def validate_targets(
    difference: Path | str | None,
    maps: Path | None,
    names: Sequence[str],
    clouds: Iterable[Path | str],
    rasters: Iterable[Path | str],
) -> None:
    """Raise ConfigError if a command would replace files that it reads, or foreign files.

    Parameters
    ----------
    difference : path, optional
        Argument of `evaluate_dtm`.
    maps : Path, optional
        Folder of the error maps.
    names : sequence of str
        Names of the maps without suffixes.
    clouds, rasters : iterable of path
        Files that the command reads.
    """
    reads = [*clouds, *(file for raster in rasters for file in files_of_raster(raster))]
    if difference is not None:
        check_difference(difference, reads)
    if maps is not None:
        files = (maps / f"{name}.{kind}" for name in names for kind in ("tif", "png"))
        check_targets([Target("--maps", file) for file in files], reads)
        validate_map_files(maps, names)


@contextmanager
def difference_writer(path: Path | str | None, like: Any, description: str) -> Iterator[Any]:
    """Yield a function that writes a block of differences (NaN: none), or None without a path.

    The file has the pixels of ``like``, an open raster. Raise ProcessingError if the GeoTIFF cannot be written.
    """
    if path is None:
        yield None
        return
    crs = like.crs.to_wkt() if like.crs else None
    look = RasterMetadata(crs, unit_label(vertical_unit(like)), description, {})
    transform = tuple(like.transform)[:6]
    with (
        raster_errors(Path(path)),
        atomic_path(Path(path)) as partial,
        plain_geotiff(partial, like.height, like.width, transform, look) as raster,
    ):

        def write(block: Float64, row: int, col: int) -> None:
            raster.write(
                np.where(np.isfinite(block), block, NODATA).astype(np.float32), row, col
            )

        yield write


@contextmanager
def _opened(dtm: Path, truth: Path) -> Iterator[Pair]:
    """Open both rasters. Raise InputError or ConfigError if they cannot be read or compared."""
    with open_raster(dtm) as dtm_raster, open_raster(truth) as true:
        _check_places(dtm, dtm_raster, truth, true)
        a, b = dtm_raster.transform, true.transform
        col, row = (a.c - b.c) / b.a, (a.f - b.f) / b.e
        if not (
            np.allclose((a.a, a.e), (b.a, b.e)) and _whole_number(col) and _whole_number(row)
        ):
            raise ConfigError(
                f"{dtm} and {truth} do not lie on one pixel lattice (pixels of {a.a:g} and {b.a:g}, "
                f"shifted by {col % 1:.3f} and {row % 1:.3f}); make the DTM with the truth's resolution"
            )
        pair = Pair(dtm_raster, true, round(row), round(col))
        apart = pair.row >= true.height or pair.col >= true.width
        if apart or pair.row + dtm_raster.height <= 0 or pair.col + dtm_raster.width <= 0:
            raise ConfigError(f"{dtm} and {truth} do not overlap; give the truth of this DTM")
        yield pair


def _check_places(dtm: Path, mine: Any, truth: Path, true: Any) -> None:
    if mine.crs and true.crs:
        dtm_crs, truth_crs = (CRS.from_wkt(raster.crs.to_wkt()) for raster in (mine, true))
        one, other = split(dtm_crs)[0], split(truth_crs)[0]
        if one is not None and other is not None and not same_horizontal(one, other):
            raise ConfigError(
                f"{dtm} is in {dtm_crs.name}, {truth} in {truth_crs.name}; bring both into one CRS (gdalwarp)"
            )
    if mine.units[0] and true.units[0] and mine.units[0] != true.units[0]:
        raise ConfigError(
            f"heights of {dtm} are in {mine.units[0]}, those of {truth} in {true.units[0]}; convert one"
        )


def _whole_number(value: float) -> bool:
    return abs(value - round(value)) < 1e-3


class _Judge:
    """Comparison of standard errors with actual errors, block by block.

    Parameters
    ----------
    pair : Pair
        Raster of standard errors, and the reference.
    """

    def __init__(self, pair: Pair) -> None:
        self._pair, self.tally = pair, SigmaTally()
        across = abs(pair.truth.transform.a) * horizontal_unit(pair.truth)
        self._step = float(across / float(vertical_unit(pair.truth)))

    def add(self, row: int, col: int, mine: Float64, true: Float64) -> None:
        """Add a block of the reference from pixel (row, col), in which the DTM has the heights ``mine``."""
        pair = self._pair
        sigma = read_heights(pair.dtm, row - pair.row, col - pair.col, *true.shape)
        slope = slopes_of(true, self._step)
        common = np.isfinite(mine) & np.isfinite(true) & np.isfinite(sigma) & (sigma > 0)
        self.tally.add((mine - true)[common], sigma[common], slope[common])


class SigmaTally:
    """Counter of errors and of the standard errors at the same pixels, in bounded memory."""

    def __init__(self) -> None:
        self._within = np.zeros(3, np.int64)
        self._by_slope = np.zeros((len(SLOPES_DEG) - 1, 3))
        self._by_sigma = np.zeros((N_CLASSES, 2))
        self._by_error = np.zeros((N_CLASSES, 2))

    def add(self, difference: Float64, sigma: Float64, slope: Float64) -> None:
        """Count pixels by their errors, standard errors and slopes.

        Parameters
        ----------
        difference, sigma : float64, shape (n,)
            Errors and standard errors in units of the heights.
        slope : float64, shape (n,)
            Slopes in degrees.
        """
        squared, size = difference**2, np.abs(difference)
        for k in (1, 2, 3):
            self._within[k - 1] += np.count_nonzero(size <= k * sigma)
        classes = np.clip(
            np.searchsorted(SLOPES_DEG, slope, side="right") - 1, 0, len(SLOPES_DEG) - 2
        )
        for column, values in enumerate((np.ones_like(sigma), squared, sigma**2)):
            self._by_slope[:, column] += np.bincount(classes, values, len(SLOPES_DEG) - 1)
        for table, values in ((self._by_sigma, sigma), (self._by_error, size)):
            class_numbers = _classes(values)
            table[:, 0] += np.bincount(class_numbers, minlength=N_CLASSES)
            table[:, 1] += np.bincount(class_numbers, squared, N_CLASSES)

    def summary(self) -> SigmaReport:
        """Return the statistics of all counted pixels."""
        n, squared, predicted = self._by_slope.sum(axis=0)
        within_1, within_2, within_3 = (
            ratio(within, int(n)) for within in self._within.tolist()
        )
        by_slope: list[SlopeFigures] = [
            {"from_deg": low, "to_deg": high, **_figures(*row)}
            for low, high, row in zip(
                SLOPES_DEG, SLOPES_DEG[1:], self._by_slope.tolist(), strict=False
            )
        ]
        curve, best = _curve(self._by_sigma), _curve(self._by_error)
        return {
            **_figures(n, squared, predicted),
            "within_1": within_1,
            "within_2": within_2,
            "within_3": within_3,
            "by_slope": by_slope,
            "area": _area(curve),
            "area_at_best": _area(best),
            "in_first_tenth": None if curve is None else float(np.interp(LOOKED_AT, *curve)),
        }


def slopes_of(truth: Float64, step: float) -> Float64:
    """Return the slopes of a block of heights in degrees.

    ``step`` is the side of a pixel in units of the heights.
    """
    return slope_deg(*gradients(np.pad(truth, 1, constant_values=np.nan), step))


def _classes(values: Float64) -> Int64:
    logarithm = np.log10(np.maximum(values, 10.0**LOWEST))
    class_numbers: Int64 = np.rint(
        (np.minimum(logarithm, HIGHEST) - LOWEST) * PER_DECADE
    ).astype(np.int64)
    return class_numbers


def _figures(n: float, squared: float, predicted: float) -> SigmaFigures:
    if not n:
        return {"pixels": 0, "rmse": None, "predicted_rmse": None}
    return {"pixels": int(n), "rmse": sqrt(squared / n), "predicted_rmse": sqrt(predicted / n)}


def _curve(table: Float64) -> tuple[Float64, Float64] | None:
    """Return shares of the pixels, largest value first, and their shares of the sum of squared errors.

    Return None if there are no errors.
    """
    if not table[:, 1].sum():
        return None
    shares = np.cumsum(table[::-1], axis=0) / table.sum(axis=0)
    return np.append(0.0, shares[:, 0]), np.append(0.0, shares[:, 1])


def _area(curve: tuple[Float64, Float64] | None) -> float | None:
    if curve is None:
        return None
    x, y = curve
    return float(np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2))
