"""Results of runs as they stand in OUT, small and made by hand: run.json and rasters."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS

WEST, NORTH, PIXEL = 500000.0, 5400000.0, 1.0
HOSTILE = '</script><img src=x onerror=alert(1)>\x1b\udc80\u202e&amp;".laz'
"""A file's name that tries to be markup, colour and bytes that are no UTF-8."""

EVALUATION = {
    "type_1": 0.0123,
    "type_2": None,
    "total": 0.01,
    "kappa": 0.975,
    "points": 3790,
    "dtm": {"unit": "metre", "rmse": 0.1234, "bias": -0.01, "pixels": 1200},
}
"""As `tiler evaluate --json` prints it."""
_DIFFERENCES = {"rmse": 0.0672, "bias": 0.05, "median": 0.048, "nmad": 0.03, "p95_abs": 0.12}
STRIPS = {
    "unit": "metre", "cell_m": 2.0, "strips": {"11": 2400, "12": 2400}, "cells": 1048, "all": _DIFFERENCES,
    "pairs": [{"first": 11, "second": 12, "cells": 1048, **_DIFFERENCES}],
}  # fmt: skip
"""As `tiler check --strips --json` prints them."""
UNMET = {"name": "rmse", "limit": 0.05, "value": 0.059, "unit": "m", "met": False}
"""Requirement that is not met, as `tiler check --json` prints it."""


def tile(number: int, across: int, side: float, **changes: Any) -> dict[str, Any]:
    column, row = number % across, number // across
    west, north = WEST + column * side, NORTH - row * side
    return {
        "key": f"t{column:+04d}{row:+04d}", "bounds": [west, north - side, west + side, north], "points": 1000 + number,
        "state": "done", "tries": 1, "marked": 0, "seconds": 1.0 + number / 100, "peak_rss_bytes": 100 << 20, **changes,
    }  # fmt: skip


def source(name: str, **changes: Any) -> dict[str, Any]:
    return {
        "path": f"/data/{name}", "points": 2000, "stored": 1900, "version": "1.4", "point_format": 6, "size": 4096,
        "crs": "WGS 84 / UTM zone 32N", "notes": [], "salvaged": False, "content": "00ff",
        "bounds": [WEST, NORTH - 40, 100.0, WEST + 60, NORTH, 120.0], **changes,
    }  # fmt: skip


def run(**changes: Any) -> dict[str, Any]:
    """The content of run.json of a finished run."""
    title = "filter: seeds, densification, labels"
    stage = {"stage": "filter0", "title": title, "tasks": 4, "done": 0, "computed": 4, "points": 4000, "seconds": 61.0,
             "peak_rss_bytes": 200 << 20}  # fmt: skip
    plan = {
        "points": 4000, "inputs": 2, "area_m2": 2400.0, "density_per_m2": 1.667, "method": "classic",
        "parameters": {"max_building_size_m": 20.0, "label_pass": True}, "crs": CRS.from_epsg(32632).to_wkt(),
        "units": {"horizontal": "metre", "vertical": "foot"},
        "metres_per_unit": {"horizontal": 1.0, "vertical": 0.3048},
        "extent": [WEST, NORTH - 40, WEST + 60, NORTH], "resolution_m": 1.0, "tile_m": 30.0, "halo_m": 104.0,
        "memory_bytes": 1 << 30, "workers": 2, "projected_memory_bytes": {"filter": 500 << 20},
        "notes": ["heights are assumed to be in feet"], "warnings": ["heights span 9,876 m"],
    }  # fmt: skip
    settings = dict.fromkeys(("resolution", "halo", "workers", "memory", "units", "crs"))
    content: dict[str, Any] = {
        "state": "done", "version": "0.1.0", "seconds": 75.0, "peak_rss_bytes": 300 << 20, "plan": plan,
        "configuration": {**settings, "tile_size": "30"}, "libraries": {"numpy": "2.3.4"},
        "counts": {"read": 4000, "stored": 3800, "dropped": {"withheld": 200}, "strays": 0},
        "filter": {"points": 3800, "ground": 1900, "unclassified": 1890, "low_noise": 10, "kept": 0, "marked": 0},
        "dtm": {"width": 60, "height": 40, "resolution_m": 1.0, "filled": 1200},
        "inputs": [source("a.laz"), source("b.laz")],
        "outputs": {"dtm.tif": 4096}, "stages": {"filter0": stage}, "statistics": {"classic": {"slope_deg": 12.5}},
        "quarantined": [], "failed_tasks": [], "strays": [], "notes": ["200 points dropped: withheld"],
        "warnings": [], "exit_code": 0,
        "tiles": {"filter0": [tile(i, 2, 30.0) for i in range(4)]},
    }  # fmt: skip
    return {**content, **changes}


def write(out: Path, content: dict[str, Any], rows: int = 40, columns: int = 60) -> Path:
    """OUT with run.json and the rasters that it names; the left half of the DTM has heights."""
    out.mkdir(exist_ok=True)
    (out / "run.json").write_text(json.dumps(content), encoding="utf-8")
    for name in content["outputs"]:
        if name.endswith(".tif"):
            write_raster(out / name, raster(name.removesuffix(".tif"), rows, columns))
    return out


def raster(product: str, rows: int, columns: int) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns]
    if product == "mask":
        return np.where(x < columns // 2, 1 + y % 4, 0).astype(np.uint8)
    if product == "density":
        return np.where(x < columns // 2, 2.0 ** (y % 5), 0).astype(np.float32)
    return np.where(x < columns // 2, 100 + 0.5 * x + np.sin(y), -9999).astype(np.float32)


def write_raster(path: Path, values: np.ndarray) -> None:
    rows, columns = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=columns, count=1, dtype=values.dtype, crs="EPSG:32632",
        nodata=-9999 if path.stem == "dtm" else 0 if path.stem == "mask" else None,
        transform=Affine(PIXEL, 0, WEST, 0, -PIXEL, NORTH),
    ) as target:  # fmt: skip
        target.write(values, 1)


class Reader(HTMLParser):
    """The text of each section, all elements, and the map's data."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.texts: dict[str, str] = {}
        self._parts: dict[str, list[str]] = {"": []}
        self.data: dict[str, Any] = {}
        self._open: list[str] = []
        self._section = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag == "section":
            self._section = str(dict(attrs)["id"])
            self._parts[self._section] = []
        self._open.append(str(dict(attrs).get("id", tag)))

    def handle_endtag(self, tag: str) -> None:
        self._open.pop()
        if tag == "section":
            self._section = ""

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] == "data":
            self.data = json.loads(data)
        elif not self._open or self._open[-1] not in ("script", "style"):
            self._parts[self._section].append(data)

    def close(self) -> None:
        super().close()
        self.texts = {
            name: re.sub(r"\s+", " ", " ".join(["", *parts]))
            for name, parts in self._parts.items()
        }


def read(path: Path) -> Reader:
    reader = Reader()
    reader.feed(path.read_text("utf-8"))
    reader.close()
    return reader
