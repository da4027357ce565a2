"""First section of the report: what was delivered, in the terms of a tender."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from pyproj import CRS

from tiler.core.crs import at_degrees, split, vertical_name
from tiler.core.nodata import NODATA
from tiler.core.products import PRODUCTS
from tiler.core.sheet_names import DEFAULT as SHEET_NAME
from tiler.core.words import counted
from tiler.io.result_folder import CLASSIFIED, written_rasters
from tiler.report.document import Content, Node, facts, section
from tiler.report.problems import Run
from tiler.report.sections import length

_GIVEN_BY_NAME = "no EPSG code known"
_CLOUDS = {"laz": "LAZ", "las": "LAS", "copc": "COPC (LAZ)"}


def specification(run: Run) -> Node:
    """Return the section with CRS, heights, pixels, sheets, dates and formats."""
    plan = run["plan"]
    units = plan.get("units", {})
    vertical = vertical_name(plan["crs"]) or "not given"
    terrain = run.get("dtm")
    size = f", {terrain['width']:,} x {terrain['height']:,} pixels" if terrain else ""
    pairs: dict[str, Content] = {
        "horizontal CRS": f"{_horizontal(run)}; unit: {units.get('horizontal', 'unknown')}",
        "vertical datum": f"{vertical}; unit: {units.get('vertical', 'unknown')}",
        "pixel": f"{length(run, plan['resolution_m'])}{size}",
        "nodata": _nodata(run),
        "sheets": _sheets(run),
        "products": "; ".join(_products(run)) or "none yet",
        "date of the survey": _survey_dates(run),
        "date of the run": str(run.get("written", "unknown"))[:10],
        "software": f"tiler {run['version']}, method {plan['method']}",
    }
    return section("specification", "Specification", facts(pairs))


def _horizontal(run: Run) -> str:
    wkt = run["plan"]["crs"]
    horizontal = None if wkt is None else split(CRS.from_wkt(wkt))[0]
    if horizontal is None:
        return "not given"
    west, south, east, north = run["plan"]["extent"]
    at = at_degrees(wkt, (west + east) / 2, (south + north) / 2)
    # The search for the code takes long, so only a finished run has it.
    code = f" ({run['crs_code'] or _GIVEN_BY_NAME})" if "crs_code" in run else ""
    return f"{horizontal.name}{code}{at}"


def _nodata(run: Run) -> str:
    """Return the nodata value of the heights, and the other values with the products that have them."""
    height = float(run["configuration"].get("nodata", NODATA))
    products: dict[str, list[str]] = {f"{height:.10g}": []}
    for name in written_rasters(run):
        value = PRODUCTS[name].nodata
        text = "none" if value is None else f"{height if value == NODATA else value:.10g}"
        products.setdefault(text, []).append(name)
    texts = [f"{text} ({', '.join(names)})" for text, names in products.items() if names]
    return "; ".join(texts) if len(texts) > 1 else next(iter(products))


def _sheets(run: Run) -> str:
    configuration = run["configuration"]
    renamed = configuration.get("product_name")
    names = f", with the names {renamed}" if renamed else ""
    if configuration.get("sheets") is None:
        return f"none, each product is one file{names}"
    side = length(run, float(Fraction(configuration["sheets"])))
    number = counted(run["sheets"], "sheet") if "sheets" in run else "sheets"
    return f"{number} with sides of {side}, files named {configuration.get('sheet_name', SHEET_NAME)}{names}"


def _products(run: Run) -> Iterator[str]:
    """Yield the products of each format."""
    configuration, outputs = run["configuration"], run.get("outputs", {})
    rasters = [f"{name} ({PRODUCTS[name].dtype})" for name in written_rasters(run)]
    if rasters:
        compression = configuration.get("compress", "deflate")
        yield f"{', '.join(rasters)} as cloud-optimized GeoTIFF, compression {compression}"
    layers = [name.removesuffix(".gpkg") for name in outputs if name.endswith(".gpkg")]
    if layers:
        yield f"{', '.join(layers)} as GeoPackage"
    clouds = sum(name.startswith(f"{CLASSIFIED}/") for name in outputs)
    if clouds:
        form = _CLOUDS.get(configuration.get("classified", "laz"), "LAZ")
        yield f"{counted(clouds, 'classified cloud')} as {form}"


def _survey_dates(run: Run) -> str:
    dates = run.get("dates")
    if not dates:
        return "unknown"
    first, last = dates["first"], dates["last"]
    days = first if first == last else f"{first} to {last}"
    return f"{days} ({dates['by']})"
