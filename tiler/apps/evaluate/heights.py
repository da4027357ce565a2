"""A DTM against a true one, block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rasterio
from pyproj import CRS

from tiler.apps.evaluate.maps import refuse_foreign_maps
from tiler.apps.evaluate.rasters import open_raster, raster_named
from tiler.core.crs import same_horizontal, split
from tiler.core.raster import NODATA
from tiler.core.spread import SpreadTally
from tiler.core.units import METRE, exact_unit, unit_label, unit_named
from tiler.errors import ConfigError, InputError
from tiler.export.geotiff import RasterLook, plain_geotiff, raster_errors
from tiler.io.overwrite_check import Target, check_targets
from tiler.io.partial_files import appearing

BLOCK = 1024
"""Pixels a side of what is in memory at a time."""

Float64s = npt.NDArray[np.float64]


class Pair(NamedTuple):
    """Two open rasters on one lattice; the DTM's pixel (0, 0) is the truth's (row, col)."""

    dtm: Any
    truth: Any
    row: int
    col: int


def evaluate_dtm(dtm: Path | str, truth: Path | str, difference: Path | str | None = None) -> dict[str, Any]:
    """Differences ``dtm - truth`` over the pixels that both have.

    The rasters are read in blocks of bounded size, whatever their extent.

    Parameters
    ----------
    dtm, truth : path
        Single-band rasters of the same CRS, unit and pixel size on the same pixel lattice; extents may differ.
    difference : path, optional
        GeoTIFF that gets the differences, float32, on the truth's pixels.

    Returns
    -------
    dict
        ``unit`` (of the heights); ``pixels``; ``only_dtm``, ``only_truth`` (valid pixels of the truth's extent that
        the other lacks); ``coverage`` (share of the truth's valid pixels that the DTM has); in units of the heights
        what `tiler.core.spread.spread` says, medians and percentiles to ``quantile_step``; None without a common
        pixel.

    Raises
    ------
    InputError
        A raster cannot be read.
    ConfigError
        The rasters are of different CRS or units, do not lie on one lattice, or do not overlap.
    ProcessingError
        ``difference`` cannot be written.
    """
    refuse_targets(difference, None, (), (), (dtm, truth))
    tally, both, only_dtm, only_truth = SpreadTally(), 0, 0, 0
    with ExitStack() as stack:
        pair = stack.enter_context(_opened(Path(dtm), Path(truth)))
        write = stack.enter_context(_difference_writer(difference, pair))
        unit = unit_label(vertical_unit(pair.truth))
        for row, col, mine, true in _blocks(pair):
            has_mine, has_true = np.isfinite(mine), np.isfinite(true)
            common = has_mine & has_true
            both += int(common.sum())
            only_dtm += int((has_mine & ~common).sum())
            only_truth += int((has_true & ~common).sum())
            tally.add(mine[common] - true[common])
            if write is not None:
                write(mine - true, row, col)
    return {
        "unit": unit,
        "pixels": both,
        "only_dtm": only_dtm,
        "only_truth": only_truth,
        "coverage": both / (both + only_truth) if both + only_truth else None,
        **tally.summary(),
        "quantile_step": tally.step,
    }


def refuse_targets(
    difference: Path | str | None,
    maps: Path | None,
    names: Sequence[str],
    clouds: Iterable[Path | str],
    rasters: Iterable[Path | str],
) -> None:
    """Raise ConfigError where `tiler evaluate` would write over what it reads, or under a name of another kind.

    Parameters
    ----------
    difference : path, optional
        As of `evaluate_dtm`.
    maps : Path, optional
        Folder of the maps of the errors, ``names`` being those of its files without their suffixes.
    names : sequence of str
    clouds, rasters : iterable of path
        What is read.
    """
    targets = [] if difference is None else [Target("--difference", difference, (".tif", ".tiff"))]
    if maps is not None:
        targets += [Target("--maps", maps / f"{name}.{kind}") for name in names for kind in ("tif", "png")]
    check_targets(targets, [*clouds, *(file for raster in rasters for file in files_of_raster(raster))])
    if maps is not None:
        refuse_foreign_maps(maps, names)


def files_of_raster(path: Path | str) -> list[str]:
    """The files that a raster is read from: its own, and those of which a VRT is made."""
    found, todo = [str(path)], [str(path)]
    while todo:
        try:
            with open_raster(todo.pop()) as raster:
                new = [file for file in raster.files if file not in found]
        except InputError:  # told of when it is read
            continue
        found += new
        todo += [file for file in new if file.lower().endswith(".vrt")]
    return found


@contextmanager
def _difference_writer(path: Path | str | None, pair: Pair) -> Iterator[Any]:
    """A function that writes a block of differences (NaN: none), or None."""
    if path is None:
        yield None
        return
    crs = pair.truth.crs.to_wkt() if pair.truth.crs else None
    look = RasterLook(crs, unit_label(vertical_unit(pair.truth)), "DTM minus truth", {})
    transform = tuple(pair.truth.transform)[:6]
    with (
        raster_errors(Path(path)),
        appearing(Path(path)) as partial,
        plain_geotiff(partial, pair.truth.height, pair.truth.width, transform, look) as raster,
    ):

        def write(block: Float64s, row: int, col: int) -> None:
            raster.write(np.where(np.isfinite(block), block, NODATA).astype(np.float32), row, col)

        yield write


@contextmanager
def _opened(dtm: Path, truth: Path) -> Iterator[Pair]:
    """Both rasters, checked against one another; raises InputError, ConfigError."""
    with open_raster(dtm) as mine, open_raster(truth) as true:
        _check_places(dtm, mine, truth, true)
        a, b = mine.transform, true.transform
        col, row = (a.c - b.c) / b.a, (a.f - b.f) / b.e
        if not (np.allclose((a.a, a.e), (b.a, b.e)) and _whole_number(col) and _whole_number(row)):
            raise ConfigError(
                f"{dtm} and {truth} do not lie on one pixel lattice (pixels of {a.a:g} and {b.a:g}, "
                f"shifted by {col % 1:.3f} and {row % 1:.3f}); make the DTM with the truth's resolution"
            )
        pair = Pair(mine, true, round(row), round(col))
        apart = pair.row >= true.height or pair.col >= true.width
        if apart or pair.row + mine.height <= 0 or pair.col + mine.width <= 0:
            raise ConfigError(f"{dtm} and {truth} do not overlap; name the truth of this DTM")
        yield pair


def _check_places(dtm: Path, mine: Any, truth: Path, true: Any) -> None:
    """Refuse rasters that say that they are of different CRS or units."""
    if mine.crs and true.crs:
        ours, theirs = (CRS.from_wkt(raster.crs.to_wkt()) for raster in (mine, true))
        one, other = split(ours)[0], split(theirs)[0]
        if one is not None and other is not None and not same_horizontal(one, other):
            raise ConfigError(
                f"{dtm} is in {ours.name}, {truth} in {theirs.name}; bring both into one CRS (gdalwarp)"
            )
    if mine.units[0] and true.units[0] and mine.units[0] != true.units[0]:
        raise ConfigError(
            f"heights of {dtm} are in {mine.units[0]}, those of {truth} in {true.units[0]}; convert one"
        )


def _whole_number(value: float) -> bool:
    return abs(value - round(value)) < 1e-3


def _blocks(pair: Pair) -> Iterator[tuple[int, int, Float64s, Float64s]]:
    """Row and column of the truth, and heights of both there; NaN where there is none."""
    for row, col, height, width in blocks_with_files(pair.truth, pair.dtm):
        mine = read_heights(pair.dtm, row - pair.row, col - pair.col, height, width)
        yield row, col, mine, read_heights(pair.truth, row, col, height, width)


def blocks_with_files(raster: Any, *others: Any) -> Iterator[tuple[int, int, int, int]]:
    """Row, column, height and width of the blocks of an open raster, but those of a VRT that no file reaches.

    A VRT over the sheets of far-apart sites has millions of these. Files of ``others``, rasters on the same lattice,
    count as well.
    """
    height, width = raster.shape
    if raster.driver == "VRT" and not (raster.transform.b or raster.transform.d):
        files = [path for each in (raster, *others) for path in _files(each)]
        places = sorted({place for path in files for place in _reached(raster, path)})
    else:
        places = [(row, col) for row in range(0, height, BLOCK) for col in range(0, width, BLOCK)]
    for row, col in places:
        yield row, col, min(BLOCK, height - row), min(BLOCK, width - col)


def _files(raster: Any) -> list[str]:
    """The files that hold the pixels of an open raster."""
    return [path for path in raster.files if path != raster.name] if raster.driver == "VRT" else [raster.name]


def _reached(vrt: Any, path: str) -> Iterator[tuple[int, int]]:
    """Row and column of the blocks of a VRT that a file comes near."""
    with rasterio.open(path) as part:
        x0, y0, x1, y1 = part.bounds
    place = vrt.transform
    left, right = sorted((x - place.c) / place.a for x in (x0, x1))
    top, bottom = sorted((y - place.f) / place.e for y in (y0, y1))
    for row in range(max(int(top) - 1, 0) // BLOCK * BLOCK, min(int(bottom) + 2, vrt.height), BLOCK):
        for col in range(max(int(left) - 1, 0) // BLOCK * BLOCK, min(int(right) + 2, vrt.width), BLOCK):
            yield row, col


def read_heights(raster: Any, row: int, col: int, height: int, width: int) -> Float64s:
    """A window of an open raster's first band; NaN where it has no data, or does not reach.

    Parameters
    ----------
    raster : rasterio data set
    row, col, height, width : int
        Pixels; the window may lie partly or wholly outside.

    Returns
    -------
    float64, shape (height, width)
    """
    heights = np.full((height, width), np.nan)
    top, left = max(row, 0), max(col, 0)
    bottom, right = min(row + height, raster.height), min(col + width, raster.width)
    if top < bottom and left < right:
        with raster_named(raster.name):
            part = raster.read(1, window=((top, bottom), (left, right)), masked=True).astype(np.float64)
        heights[top - row : bottom - row, left - col : right - col] = part.filled(np.nan)
    return heights


def vertical_unit(raster: Any) -> Fraction:
    """Metres in one unit of an open raster's heights: the band's, else that of its CRS, else a metre."""
    return unit_named(raster.units[0]) if raster.units[0] else _crs_unit(raster)


def horizontal_unit(dtm: Path) -> Fraction:
    """Metres in one unit of a raster's coordinates; a metre where it has no CRS. Raises InputError."""
    with open_raster(dtm) as raster:
        return _crs_unit(raster)


def _crs_unit(raster: Any) -> Fraction:
    """Metres in one unit of a raster's CRS; a metre where it has none, or one of degrees."""
    known = raster.crs is not None and raster.crs.is_projected
    return exact_unit(raster.crs.linear_units_factor[1]) if known else METRE
