"""Places to review as a GeoPackage that QGIS opens with a style and a form."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely

from ptd.arrays import AnyArray, Float64
from tiler.core.edits import ACTIONS
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.products import SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.review import (
    FIXED,
    HOLES,
    LAYER,
    NUMBERS,
    OK,
    OPEN,
    STATUSES,
    TEXTS,
    ReviewRow,
    is_edit,
    ranked,
)
from tiler.export.output_files import OutFile, ReviewFileRecord, new_file
from tiler.export.polygons import polygons_of
from tiler.io.vector import geopackage
from tiler.io.vector.writing import WHEN
from tiler.store import TileStore, coarse_values

COLOURS = {OPEN: "209,73,91", OK: "91,140,90", FIXED: "42,111,151"}
"""Red, green and blue of the outlines by status."""
STYLES = "layer_styles"
"""Table from which QGIS takes the styles of the layers of a GeoPackage."""


MOST_BLOCKS = 256
"""Number of blocks up to which a place has the outline of its pixels. A ragged void has some 10,000 corners in each."""
COARSE = "its outline here is coarse and holds land as well: draw the edit, or use the setting for the whole run"
"""Addition to the remedy of larger places, whose outline would take away heights around them."""


@dataclass(frozen=True)
class DeliveredTerrain:
    """Raster of the terrain, its pixels, cells of the survey, and keys of bodies of water and area."""

    raster: str
    spec: RasterSpec
    coarse: RasterSpec
    waters: str | None
    area: str | None


def write_review(
    store: TileStore,
    *,
    to: OutFile,
    found: tuple[ReviewRow, ...],
    decided: tuple[ReviewRow, ...],
    terrain: DeliveredTerrain | None,
) -> ReviewFileRecord:
    """Write places to review as polygons: those of the run, worst first, and those that a user decided on.

    The outline of voids and places without returns is that of their pixels, for which ``terrain`` is needed.

    Columns are ``rank`` (1 for the first), ``status`` (open, ok or fixed), ``reason``, ``why``, ``action`` (of the
    edit that a row becomes once it is fixed) and its height ``z``, ``stake_m`` (height by which the terrain may be
    wrong), ``area_m2``, ``chance`` (that it is wrong), ``sheet``, ``remedy`` and ``note`` (of the user).

    Return the `ReviewFileRecord`. Raise ProcessingError if the file cannot be written.
    """
    outlined = [
        _outlined(store, row, terrain) if terrain and row.pixels else row for row in found
    ]
    rows, right = ranked(outlined, decided)
    shapes = shapely.from_wkb([row.shape for row in rows])
    texts = {name: np.array([getattr(row, name) for row in rows], object) for name in TEXTS}
    # None becomes NaN, which is NULL in the file.
    numbers = {
        name: np.array([getattr(row, name) for row in rows], np.float64) for name in NUMBERS
    }
    columns = {"rank": np.arange(1, len(rows) + 1, dtype=np.int32), **texts, **numbers}
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        file.add(LAYER, "MultiPolygon", list(shapes), columns)
        file.add(STYLES, None, None, _style())
    counts = Counter(FIXED if is_edit(row.status) else row.status for row in rows)
    return ReviewFileRecord(
        **new.record.to_json(),
        open=counts[OPEN],
        ok=counts[OK],
        fixed=counts[FIXED],
        right=[[row.reason, row.why, *row.where] for row in right],
    )


def _outlined(store: TileStore, row: ReviewRow, terrain: DeliveredTerrain) -> ReviewRow:
    """Return a row with the outline of its pixels, which may be empty. A large place keeps its coarse outline."""
    area = store.area(terrain.area)
    around = shapely.from_wkb(row.shape)
    edges = np.rint(np.array(around.bounds) * COUNTS_PER_UNIT).astype(int).tolist()
    blocks = [
        block
        for block in terrain.spec.blocks_within(Bounds(*edges), BLOCK_PIXELS)
        if shapely.intersects(around, shapely.box(*_edges(terrain.spec, block)))
    ]
    if len(blocks) > MOST_BLOCKS:
        return replace(row, action="", remedy="; ".join(filter(None, (row.remedy, COARSE))))
    pieces = [np.empty(0, object)]
    for block in blocks:
        cells = coarse_values(store, "survey", terrain.coarse, terrain.spec, block)
        heights = store.read_block(terrain.raster, block)
        has_height = heights != np.float32(NODATA)
        if row.pixels == HOLES:
            inside = (cells >= SURVEYED) & ~has_height & terrain.spec.inside(block, area)
        else:
            inside = (cells >= VOID) & has_height
        waters = store.waters(terrain.waters, terrain.spec.block_bounds(block))
        if waters is not None:
            inside &= ~waters.inside(terrain.spec, block)
        pieces.append(polygons_of(inside, terrain.spec, block))
    exact = shapely.intersection(shapely.union_all(np.concatenate(pieces)), around)
    polygons = [part for part in shapely.get_parts(exact) if part.geom_type == "Polygon"]
    shape = shapely.normalize(shapely.MultiPolygon(polygons)).simplify(0.0)
    return replace(row, shape=shapely.to_wkb(shape, hex=True))


def _edges(spec: RasterSpec, block: Block) -> Float64:
    """Return west, south, east and north of a block in units of the CRS."""
    return np.array(spec.block_bounds(block).to_json()) / COUNTS_PER_UNIT


def _style() -> dict[str, AnyArray]:
    """Return the table of styles: colours by status, and lists for status and action in the form."""
    texts = {
        "f_table_catalog": "",
        "f_table_schema": "",
        "f_table_name": LAYER,
        "f_geometry_column": "geom",
        "styleName": LAYER,
        "styleQML": _qml(),
        "styleSLD": "",
        "description": "places to review, by status",
        "owner": "",
        "ui": "",
    }
    return {
        **{name: np.array([text], object) for name, text in texts.items()},
        "useAsDefault": np.array([True]),
        "update_time": np.array([WHEN.rstrip("Z")], "datetime64[ms]"),
    }


def _qml() -> str:
    categories = "".join(
        f'<category value="{status}" label="{status}" symbol="{i}" render="true"/>'
        for i, status in enumerate(STATUSES)
    )
    symbols = "".join(
        f'<symbol type="fill" name="{i}" alpha="1" clip_to_extent="1" force_rhr="0">'
        '<layer class="SimpleFill" enabled="1" locked="0" pass="0"><Option type="Map">'
        f"{_option('color', COLOURS[status] + ',40')}{_option('outline_color', COLOURS[status] + ',255')}"
        f"{_option('outline_width', '0.6')}{_option('style', 'solid')}</Option></layer></symbol>"
        for i, status in enumerate(STATUSES)
    )
    lists = _list("status", STATUSES) + _list("action", ("", *ACTIONS))
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>"
        '<qgis version="3.22.0" styleCategories="Symbology|Forms|Fields">'
        f'<renderer-v2 type="categorizedSymbol" attr="status" symbollevels="0" enableorderby="0">'
        f"<categories>{categories}</categories><symbols>{symbols}</symbols></renderer-v2>"
        f"<fieldConfiguration>{lists}</fieldConfiguration>"
        '<attributetableconfig sortExpression="&quot;rank&quot;" sortOrder="0"/></qgis>'
    )


def _list(column: str, values: tuple[str, ...]) -> str:
    """Return the form's list of values for a column."""
    entries = "".join(
        f'<Option type="Map">{_option(value or "(none)", value)}</Option>' for value in values
    )
    return (
        f'<field name="{column}"><editWidget type="ValueMap"><config><Option type="Map">'
        f'<Option type="List" name="map">{entries}</Option></Option></config></editWidget></field>'
    )


def _option(name: str, value: str) -> str:
    return f'<Option type="QString" name={quoteattr(name)} value={quoteattr(value)}/>'
