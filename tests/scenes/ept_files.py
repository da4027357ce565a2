"""Entwine point tiles for tests: the points of a cloud in an octree of LAZ files, in pages of two levels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from tests.scenes.copc_files import nodes_of

LEVELS_OF_PAGE = 2


def write_ept(folder: Path, las: laspy.LasData, most: int, **changes: Any) -> Path:
    """Write the points of a cloud as ``ept.json`` and what it names; its files have no CRS."""
    xyz = np.asarray(las.xyz)
    low, side = xyz.min(axis=0), float(np.ptp(xyz, axis=0).max()) or 1.0
    for name in ("ept-data", "ept-hierarchy"):
        (folder / name).mkdir(parents=True)
    pages: dict[str, dict[str, int]] = {}
    for key, rows in nodes_of(xyz, low, side, most).items():
        name, header = (
            "-".join(map(str, key)),
            laspy.LasHeader(version="1.4", point_format=las.point_format.id),
        )
        header.scales, header.offsets = place = las.header.scales, las.header.offsets
        node = laspy.LasData(header)
        node.points = laspy.ScaleAwarePointRecord(
            las.points.array[rows], las.point_format, *place
        )
        node.write(folder / "ept-data" / f"{name}.laz")
        own = key[0] % LEVELS_OF_PAGE == 0
        page = key if own else (key[0] - 1, *(v // 2 for v in key[1:]))
        pages.setdefault("-".join(map(str, page)), {})[name] = len(rows)
        if own and key[0]:  # the page above names it, too
            above = tuple(v // 2**LEVELS_OF_PAGE for v in key[1:])
            pages["-".join(map(str, (key[0] - LEVELS_OF_PAGE, *above)))][name] = -1
    for name, entries in pages.items():
        (folder / "ept-hierarchy" / f"{name}.json").write_text(json.dumps(entries))
    crs = las.header.parse_crs()
    srs = {"authority": "EPSG", "horizontal": str(crs.to_epsg()), "wkt": crs.to_wkt()}
    content = {
        "version": "1.0.0",
        "dataType": "laszip",
        "hierarchyType": "json",
        "span": 128,
        "srs": srs,
    }
    content |= {"points": len(xyz), "bounds": [*low, *(low + side)]}
    (folder / "ept.json").write_text(json.dumps({**content, **changes}))
    return folder / "ept.json"
