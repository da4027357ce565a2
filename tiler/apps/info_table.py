"""Table of clouds, with a row per cloud, from their headers and a few of their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tiler.core.crs import crs_name, crs_warnings
from tiler.core.units_text import short_unit
from tiler.errors import InputError
from tiler.inputs import SourceInfo, find_inputs, inspect_in_child
from tiler.inputs.lists import is_virtual
from tiler.io.locations import is_url
from tiler.io.result_folder import RUN
from tiler.schedule import ChildPool

COLUMNS = (
    "file",
    "points",
    "per m2",
    "west",
    "south",
    "east",
    "north",
    "lowest",
    "highest",
    "unit",
    "CRS",
)
ZARR = "zarr.json"
"""Name of a file that identifies a folder as a tile store."""


def is_many(paths: Sequence[str]) -> bool:
    """Return whether paths are described in a table: several paths, or a folder, list or pattern of clouds."""
    if len(paths) != 1:
        return True
    path = Path(paths[0])
    if is_url(paths[0]) or path.is_file():
        return is_virtual(paths[0])
    if path.is_dir():
        return not ((path / RUN).is_file() or (path / ZARR).is_file())
    return any(sign in paths[0] for sign in "*?[")


@dataclass(frozen=True, kw_only=True)
class ListedCloud:
    """Cloud in the table.

    Attributes
    ----------
    path : str
    points : int
    per_m2 : float or None
        Mean density in its bounds.
    bounds : tuple of float, or None
        Lowest x, y, z, highest x, y, z in units of the CRS.
    unit, crs : str or None
    warnings : list of str
    """

    path: str
    points: int
    per_m2: float | None
    bounds: tuple[float, ...] | None
    unit: str | None
    crs: str | None
    warnings: list[str]


@dataclass(frozen=True)
class UnreadableCloud:
    """Cloud that cannot be read, and why."""

    path: str
    error: str


def describe_many(paths: Sequence[str]) -> list[ListedCloud | UnreadableCloud]:
    """Describe each cloud that is found in some files, folders, virtual point clouds and globs.

    Raises
    ------
    ConfigError
        A path does not exist.
    InputError
        There is no cloud.
    """
    descriptions: list[ListedCloud | UnreadableCloud] = []
    files = find_inputs(paths)
    with ChildPool(1) as guards:
        for path, look in zip(files, guards.each(inspect_in_child, files), strict=True):
            try:
                descriptions.append(_listed(look()))
            except InputError as error:
                descriptions.append(
                    UnreadableCloud(str(path), str(error).removeprefix(f"{path}: "))
                )
    return descriptions


def _listed(source: SourceInfo) -> ListedCloud:
    georeference = source.georeference
    metres, per_m2 = georeference.horizontal, None
    if source.bounds is not None and metres is not None:
        x0, y0, _, x1, y1, _ = source.bounds
        area = (x1 - x0) * (y1 - y0) * float(metres) ** 2
        per_m2 = source.points / area if area > 0 else None
    return ListedCloud(
        path=str(source.path),
        points=source.points,
        per_m2=per_m2,
        bounds=source.bounds,
        unit=None if metres is None else short_unit(metres),
        crs=crs_name(georeference.wkt),
        warnings=crs_warnings(georeference.wkt, source.bounds),
    )


def rows(clouds: Sequence[ListedCloud | UnreadableCloud]) -> list[list[str]]:
    """Return the rows of the table, with cells in the order of `COLUMNS`."""
    return [_row(cloud) for cloud in clouds]


def _row(cloud: ListedCloud | UnreadableCloud) -> list[str]:
    if isinstance(cloud, UnreadableCloud):
        return [cloud.path, cloud.error, *[""] * (len(COLUMNS) - 2)]
    density = "-" if cloud.per_m2 is None else f"{cloud.per_m2:.3g}"
    bounds = cloud.bounds
    bounds_texts = (
        ["-"] * 6 if bounds is None else [f"{bounds[i]:.2f}" for i in (0, 1, 3, 4, 2, 5)]
    )
    return [
        cloud.path,
        f"{cloud.points:,}",
        density,
        *bounds_texts,
        cloud.unit or "-",
        f"{cloud.crs or '-'}{', outside its area of use' if cloud.warnings else ''}",
    ]
