"""Comparison of a DTM with a reference raster, block by block."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rasterio
from pyproj import CRS

from tiler.apps.evaluate.labels import ratio
from tiler.apps.evaluate.maps import validate_map_files
from tiler.apps.evaluate.rasters import open_raster, raster_named
from tiler.apps.evaluate.results import DtmScores, SigmaScores
from tiler.apps.evaluate.sigma import SigmaTally, slopes_of
from tiler.core.crs import same_horizontal, split
from tiler.core.difference_statistics import SpreadTally
from tiler.core.raster import NODATA
from tiler.core.units import METRE, exact_unit, unit_label, unit_named
from tiler.errors import ConfigError, InputError
from tiler.io.atomic_files import atomic_path
from tiler.io.overwrite_check import Target, check_targets
from tiler.io.raster_files import RasterMetadata, plain_geotiff, raster_errors
from tiler.io.result_folder import raster_places, read_run

BLOCK = 1024
"""Side in pixels of a block. One block per raster is in memory at a time."""

Float64s = npt.NDArray[np.float64]


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
        write = stack.enter_context(_difference_writer(difference, pair))
        unit = unit_label(vertical_unit(pair.truth))
        judge = (
            None
            if sigma is None
            else _Judge(stack.enter_context(_opened(Path(sigma), Path(truth))))
        )
        for row, col, dtm_heights, true in _blocks(pair):
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
    judged: SigmaScores = {}
    if judge is not None:
        judged = {"sigma": judge.tally.summary(), "sigma_file": str(sigma)}
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


class _Judge:
    """Comparison of standard errors with actual errors, block by block.

    Parameters
    ----------
    pair : Pair
        Raster of standard errors, and the reference.
    """

    def __init__(self, pair: Pair) -> None:
        self._pair, self.tally = pair, SigmaTally()
        across = abs(pair.truth.transform.a) * _crs_unit(pair.truth)
        self._step = float(across / float(vertical_unit(pair.truth)))

    def add(self, row: int, col: int, mine: Float64s, true: Float64s) -> None:
        """Add a block of the reference from pixel (row, col), in which the DTM has the heights ``mine``."""
        pair = self._pair
        sigma = read_heights(pair.dtm, row - pair.row, col - pair.col, *true.shape)
        slope = slopes_of(true, self._step)
        common = np.isfinite(mine) & np.isfinite(true) & np.isfinite(sigma) & (sigma > 0)
        self.tally.add((mine - true)[common], sigma[common], slope[common])


def sigma_beside(dtm: Path | str) -> Path | None:
    """Return the raster of standard errors that a run wrote next to its DTM, or None."""
    path = Path(dtm)
    run = read_run(str(path.parent))
    pairs = zip(raster_places(run, "dtm"), raster_places(run, "sigma"), strict=True)
    found = (path.with_name(sigma) for terrain, sigma in pairs if terrain == path.name)
    return next((sigma for sigma in found if sigma.is_file()), None)


def validate_targets(
    difference: Path | str | None,
    maps: Path | None,
    names: Sequence[str],
    clouds: Iterable[Path | str],
    rasters: Iterable[Path | str],
) -> None:
    """Raise ConfigError if `tiler evaluate` would replace files that it reads, or foreign files.

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
    targets, reads = [], list(clouds)
    if difference is not None:
        targets.append(Target("--difference", difference, (".tif", ".tiff")))
    if maps is not None:
        for name in names:
            targets += [Target("--maps", maps / f"{name}.{kind}") for kind in ("tif", "png")]
    for raster in rasters:
        reads += files_of_raster(raster)
    check_targets(targets, reads)
    if maps is not None:
        validate_map_files(maps, names)


def files_of_raster(path: Path | str) -> list[str]:
    """Return the files of a raster, including the files to which a VRT refers."""
    files, todo = [str(path)], [str(path)]
    while todo:
        try:
            with open_raster(todo.pop()) as raster:
                new = [file for file in raster.files if file not in files]
        except InputError:  # The fault is reported when the raster is read.
            continue
        files += new
        todo += [file for file in new if file.lower().endswith(".vrt")]
    return files


@contextmanager
def _difference_writer(path: Path | str | None, pair: Pair) -> Iterator[Any]:
    """Yield a function that writes a block of differences (NaN: none), or None without a path."""
    if path is None:
        yield None
        return
    crs = pair.truth.crs.to_wkt() if pair.truth.crs else None
    look = RasterMetadata(crs, unit_label(vertical_unit(pair.truth)), "DTM minus truth", {})
    transform = tuple(pair.truth.transform)[:6]
    with (
        raster_errors(Path(path)),
        atomic_path(Path(path)) as partial,
        plain_geotiff(partial, pair.truth.height, pair.truth.width, transform, look) as raster,
    ):

        def write(block: Float64s, row: int, col: int) -> None:
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


def _blocks(pair: Pair) -> Iterator[tuple[int, int, Float64s, Float64s]]:
    """Yield row and column in the reference and the heights of both rasters (NaN: none), per block."""
    for row, col, height, width in blocks_with_files(pair.truth, pair.dtm):
        dtm_heights = read_heights(pair.dtm, row - pair.row, col - pair.col, height, width)
        yield row, col, dtm_heights, read_heights(pair.truth, row, col, height, width)


def blocks_with_files(raster: Any, *others: Any) -> Iterator[tuple[int, int, int, int]]:
    """Yield row, column, height and width of the blocks of an open raster.

    Blocks of a VRT are left out if they are not near a file of the VRT or of ``others``,
    rasters on the same lattice. A VRT over the sheets of distant sites has millions of empty
    blocks.
    """
    height, width = raster.shape
    if raster.driver == "VRT" and not (raster.transform.b or raster.transform.d):
        reached: set[tuple[int, int]] = set()
        for each in (raster, *others):
            for path in _files(each):
                reached.update(_reached(raster, path))
        block_corners = sorted(reached)
    else:
        block_corners = list(itertools.product(range(0, height, BLOCK), range(0, width, BLOCK)))
    for row, col in block_corners:
        yield row, col, min(BLOCK, height - row), min(BLOCK, width - col)


def _files(raster: Any) -> list[str]:
    """Return the files that contain the pixels of an open raster."""
    if raster.driver != "VRT":
        return [raster.name]
    return [path for path in raster.files if path != raster.name]


def _reached(vrt: Any, path: str) -> Iterator[tuple[int, int]]:
    """Yield row and column of the blocks of a VRT that are at most two pixels from a file."""
    with rasterio.open(path) as part:
        x0, y0, x1, y1 = part.bounds
    transform = vrt.transform
    left, right = sorted((x - transform.c) / transform.a for x in (x0, x1))
    top, bottom = sorted((y - transform.f) / transform.e for y in (y0, y1))
    for row in range(
        max(int(top) - 1, 0) // BLOCK * BLOCK, min(int(bottom) + 2, vrt.height), BLOCK
    ):
        for col in range(
            max(int(left) - 1, 0) // BLOCK * BLOCK, min(int(right) + 2, vrt.width), BLOCK
        ):
            yield row, col


def read_heights(raster: Any, row: int, col: int, height: int, width: int) -> Float64s:
    """Read a window of an open raster's first band, with NaN without data and beyond the raster.

    Parameters
    ----------
    raster : rasterio data set
    row, col, height, width : int
        First pixel and size of the window in pixels. It may lie partly or wholly beyond the raster.

    Returns
    -------
    float64, shape (height, width)
    """
    heights = np.full((height, width), np.nan)
    top, left = max(row, 0), max(col, 0)
    bottom, right = min(row + height, raster.height), min(col + width, raster.width)
    if top < bottom and left < right:
        with raster_named(raster.name):
            part = raster.read(1, window=((top, bottom), (left, right)), masked=True).astype(
                np.float64
            )
        heights[top - row : bottom - row, left - col : right - col] = part.filled(np.nan)
    return heights


def vertical_unit(raster: Any) -> Fraction:
    """Return the metres in one unit of an open raster's heights: that of the band, else of the CRS."""
    if raster.units[0]:
        return unit_named(raster.units[0])
    return _crs_unit(raster)


def horizontal_unit(dtm: Path) -> Fraction:
    """Return the metres in one unit of a raster's coordinates, or 1 without a projected CRS.

    Raise InputError if the raster cannot be read.
    """
    with open_raster(dtm) as raster:
        return _crs_unit(raster)


def _crs_unit(raster: Any) -> Fraction:
    """Return the metres in one unit of a raster's CRS, or 1 without a projected CRS."""
    if raster.crs is None or not raster.crs.is_projected:
        return METRE
    return exact_unit(raster.crs.linear_units_factor[1])
