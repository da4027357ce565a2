"""Writing of a raster of the store as a cloud-optimised GeoTIFF (COG).

A COG has its overviews before the full resolution, so blocks cannot be written in their order.
They go to a plain tiled GeoTIFF, which GDAL's COG driver then copies with bounded memory. Both
are scratch files next to the target until the COG is complete. The plain file needs up to 4
bytes per pixel, and nothing for blocks without data.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
import rasterio.shutil
from rasterio.windows import Window

from tiler.core.crs import raster_crs
from tiler.core.lattice import COUNTS_PER_UNIT, CoordFrame
from tiler.core.products import HEIGHT, PRODUCTS, Product
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.units import unit_label
from tiler.errors import ProcessingError
from tiler.export.output_files import new_file
from tiler.export.records import RasterFileRecord
from tiler.export.work import OutFile, ProductInfo, RasterPart
from tiler.io.atomic_files import clear_partial, partial_path, replace_file, sync_folder
from tiler.io.raster_files import CACHE_MB, RasterMetadata, plain_geotiff, raster_errors
from tiler.store import TileStore


@dataclass(frozen=True)
class Statistics:
    """Statistics of the valid pixels. Blocks are merged in a fixed order, so the result does not depend on tiles."""

    n: int = 0
    low: float = math.inf
    high: float = -math.inf
    mean: float = 0.0
    squares: float = 0.0

    def merged(self, block: npt.NDArray[Any], nodata: float | None = NODATA) -> Statistics:
        """Return the statistics with one more block (Chan, Golub and LeVeque 1979, eq. 2.1)."""
        valid = block.ravel()
        if nodata is not None:
            valid = valid[valid != np.float32(nodata)]
        values = valid.astype(np.float64)
        if values.size == 0:
            return self
        n, mean = self.n + values.size, float(values.mean())
        shift = mean - self.mean
        return Statistics(
            n,
            min(self.low, float(values.min())),
            max(self.high, float(values.max())),
            self.mean + shift * values.size / n,
            self.squares
            + float(((values - mean) ** 2).sum())
            + shift**2 * self.n * values.size / n,
        )

    def tags(self, pixels: int) -> dict[str, str]:
        """Return GDAL's metadata items of a band with ``pixels`` pixels."""
        tags = {"STATISTICS_VALID_PERCENT": f"{100 * self.n / pixels:.4g}"}
        if self.n:
            tags |= {
                "STATISTICS_MINIMUM": repr(self.low),
                "STATISTICS_MAXIMUM": repr(self.high),
                "STATISTICS_MEAN": repr(self.mean),
                "STATISTICS_STDDEV": repr(math.sqrt(self.squares / self.n)),
            }
        return tags


def write_cog(
    store: TileStore, *, to: OutFile, info: ProductInfo, part: RasterPart, compress: str
) -> RasterFileRecord:
    """Write a raster of the store, or a sheet of it, as one file, compressed by ``deflate`` or ``zstd``.

    The same content gives the same bytes, since the file does not contain time, path, workers
    or tiles.

    Returns
    -------
    RasterFileRecord
        Record of the file.

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    with new_file(to) as file:
        statistics = _write(store, info, part, compress, file.path)
    is_empty = statistics.n == 0
    return RasterFileRecord(
        **file.record.to_json(),
        pixels=part.spec.height * part.spec.width,
        valid=statistics.n,
        min=None if is_empty else statistics.low,
        max=None if is_empty else statistics.high,
        mean=None if is_empty else statistics.mean,
    )


def _write(
    store: TileStore, info: ProductInfo, part: RasterPart, compress: str, target: Path
) -> Statistics:
    """Write a raster to a file on this machine."""
    plain = partial_path(target, "plain")
    partial = partial_path(target, "cog")
    with raster_errors(target):
        clear_partial(plain)
        clear_partial(partial)
    try:
        statistics = _write_plain(store, info, part, plain)
        _copy_as_cog(plain, partial, compress, _product(info))
        _check(partial, part.spec)
        _publish(partial, target)
        return statistics
    finally:
        for scratch in (plain, partial, *target.parent.glob(f"{partial.name}.*")):
            with suppress(FileNotFoundError):
                scratch.unlink()


def _product(info: ProductInfo) -> Product:
    """Return the product with the nodata value of its file."""
    product = PRODUCTS[info.product]
    if info.nodata is None:
        return product
    return replace(product, nodata=info.nodata)


def _write_plain(
    store: TileStore, info: ProductInfo, part: RasterPart, path: Path
) -> Statistics:
    """Copy the raster block by block, row by row from the north-west."""
    spec = part.spec
    statistics = Statistics()
    nodata = PRODUCTS[info.product].nodata
    look = raster_metadata(store.meta.frame, info)
    area = store.area(part.area)
    with plain_geotiff(
        path, spec.height, spec.width, spec.transform(COUNTS_PER_UNIT), look
    ) as raster:
        for block in spec.blocks(BLOCK_PIXELS):
            values = _read(store, part, block)
            if area is not None:
                values = np.where(spec.inside(block, area), values, np.float32(part.fill))
            statistics = statistics.merged(values, nodata)
            if nodata is None or np.any(values != np.float32(nodata)):
                if look.nodata != nodata:
                    values = np.where(
                        values == np.float32(nodata), np.float32(look.nodata), values
                    )
                raster.write(values, block.row, block.col)
        raster.tag_band({**look.meanings, **statistics.tags(spec.height * spec.width)})
    return statistics


def _read(store: TileStore, part: RasterPart, block: Block) -> npt.NDArray[np.float32]:
    """Return a block of the file. Pixels beyond the raster of the store have the value ``fill``."""
    spec, whole = part.spec, part.whole
    if whole is None:
        return store.read_block(part.raster, block)
    row, col = block.row + whole.north - spec.north, block.col + spec.west - whole.west
    top, left = max(row, 0), max(col, 0)
    bottom, right = min(row + block.height, whole.height), min(col + block.width, whole.width)
    values = np.full((block.height, block.width), part.fill, np.float32)
    if top < bottom and left < right:
        there = store.read_block(part.raster, Block(top, left, bottom - top, right - left))
        values[top - row : bottom - row, left - col : right - col] = there
    return values


def raster_metadata(frame: CoordFrame, info: ProductInfo) -> RasterMetadata:
    """Return the metadata of the file of a product."""
    product = _product(info)
    unit = product.unit
    if unit == HEIGHT:
        unit = unit_label(frame.units.vertical)
    return RasterMetadata(
        crs=raster_crs(frame.crs_wkt),
        unit=unit,
        description=product.description,
        tags=info.tags,
        dtype=product.dtype,
        nodata=product.nodata,
        colours=product.colours,
        meanings={f"VALUE_{value}": text for value, text in product.values.items()},
        categories=product.categories,
    )


def _copy_as_cog(plain: Path, partial: Path, compress: str, product: Product) -> None:
    """Copy a GeoTIFF as COG: GDAL orders, compresses and builds overviews in one thread and bounded memory."""
    options = {
        "COMPRESS": compress.upper(),
        "PREDICTOR": product.predictor,
        "OVERVIEW_PREDICTOR": product.predictor,
        "BLOCKSIZE": BLOCK_PIXELS,
        "OVERVIEW_RESAMPLING": product.resampling,
        "OVERVIEWS": "AUTO",
        "BIGTIFF": "IF_SAFER",
        "NUM_THREADS": 1,
        "STATISTICS": "AUTO",  # The statistics of the plain file are kept.
    }
    with rasterio.Env(GDAL_CACHEMAX=CACHE_MB, GDAL_NUM_THREADS=1), raster_errors(partial):
        partial.unlink(missing_ok=True)
        rasterio.shutil.copy(plain, partial, driver="COG", **options)


def _check(partial: Path, spec: RasterSpec) -> None:
    """Read the last block and raise ProcessingError if it is damaged.

    GDAL may notice a full disk only when it closes the file, and may not report it.
    """
    row = (spec.height - 1) // BLOCK_PIXELS * BLOCK_PIXELS
    col = (spec.width - 1) // BLOCK_PIXELS * BLOCK_PIXELS
    last = spec.block_at(row, col, BLOCK_PIXELS)
    with raster_errors(partial), rasterio.open(partial) as raster:
        if raster.shape != (spec.height, spec.width):
            raise ProcessingError(
                f"{partial}: {raster.shape} pixels instead of {(spec.height, spec.width)}"
            )
        raster.read(1, window=Window(last.col, last.row, last.width, last.height))


def _publish(partial: Path, target: Path) -> None:
    """Give a complete file its final name, and sync it to the disk."""
    with raster_errors(target):
        # Windows cannot sync a file that is open only for reading.
        with open(partial, "rb+") as stream:
            os.fsync(stream.fileno())
        replace_file(partial, target)
        sync_folder(target.parent)
