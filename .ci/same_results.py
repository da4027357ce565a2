"""Compare the results of two runs: clouds by their bytes, rasters by their pixels, with an error if they differ."""

import sys
from pathlib import Path

import numpy as np
import rasterio


def results(folder: Path) -> dict[str, Path]:
    """Return the clouds and rasters in a folder, by their path in it."""
    files = sorted(p for p in folder.rglob("*.*") if p.suffix in (".laz", ".tif"))
    return {p.relative_to(folder).as_posix(): p for p in files}


def same(one: Path, other: Path) -> bool:
    """Return whether two clouds or rasters are the same."""
    if one.suffix == ".laz":
        return one.read_bytes() == other.read_bytes()
    with rasterio.open(one) as a, rasterio.open(other) as b:
        equal = [
            getattr(a, name) == getattr(b, name) for name in ("crs", "transform", "nodata")
        ]
        return all(equal) and np.array_equal(a.read(), b.read())


first, second = (results(Path(folder)) for folder in sys.argv[1:3])
differing = set(first) ^ set(second)
differing |= {name for name in set(first) & set(second) if not same(first[name], second[name])}
if differing or not first:
    sys.exit(f"{len(first)} and {len(second)} results, these differ: {sorted(differing)}")
sys.stdout.write(f"{len(first)} clouds and rasters are the same\n")
