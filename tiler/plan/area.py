"""The part of the plane that a run is about, from ``--bounds`` or ``--aoi``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pyproj import CRS, Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError

from tiler.config import RunConfig
from tiler.config.parsing import FARTHEST
from tiler.core.area import Area, shortened
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.errors import ConfigError, InputError
from tiler.ingest import SourceInfo, bounds_in_counts, same_horizontal, split
from tiler.io.json_text import excerpt
from tiler.io.vector import read_polygons
from tiler.plan.model import Plan
from tiler.plan.sizes import bounds_of
from tiler.schedule import read_apart

MOST_HALVINGS = 12
"""How often an edge is halved at most, where it bends on its way into another CRS."""
BEND = 0.005
"""Units of the CRS by which a straight edge may leave the bent one."""

RETURN, RETURN_DEG = 1e-2, 1e-6
"""Units or degrees to which a place comes back from another CRS; none does from far beyond the reach of one."""

Ring = npt.NDArray[np.float64]


def area_of(config: RunConfig, wkt: str | None, notes: list[str]) -> Area | None:
    """The area that a run is asked for, in absolute counts of its CRS; None: all that the inputs hold.

    Parameters
    ----------
    config : RunConfig
    wkt : str or None
        CRS of the run; None if it is unknown.
    notes : list of str
        Gets what was decided.

    Raises
    ------
    ConfigError
        Both settings are given, or the bounds hold no place.
    InputError
        The file cannot be used: format, no polygon, CRS.
    """
    if config.bounds is not None and config.aoi is not None:
        raise ConfigError("--bounds and --aoi: both name a part of the survey; give one of them")
    if config.bounds is not None:
        bounds = bounds_in_counts(config.bounds)
        if bounds.empty:
            raise ConfigError(f"--bounds {' '.join(f'{v:g}' for v in config.bounds)}: holds no place")
        return Area.rectangle(bounds)
    if config.aoi is None:
        return None
    path = Path(config.aoi)
    if config.in_process:
        area, decided = read_area(path, wkt)
    else:
        area, decided = read_apart(read_area, path, wkt, paths=(path,))
    notes += decided
    return area


def read_area(path: Path, wkt: str | None) -> tuple[Area, list[str]]:
    """The polygons of a file in absolute counts of a CRS, and what was decided about them; raises InputError."""
    notes: list[str] = []
    polygons = read_polygons(path)
    rings = _in_crs(path, polygons.rings, polygons.crs, wkt, notes)
    if any(np.abs(ring).max() >= FARTHEST for rs in rings for ring in rs):
        raise InputError(f"{path}: has a place farther away than {FARTHEST:g}; write coordinates of its CRS")
    counts = tuple(
        tuple(shortened(np.rint(r * COUNTS_PER_UNIT).astype(np.int64)) for r in rs) for rs in rings
    )
    area = Area(counts)
    if area.bounds.empty:
        raise InputError(f"{path}: its polygons hold no place; draw them wider")
    return area, notes


def part_of(plan: Plan) -> Plan:
    """The plan with what its area leaves: files that come near it, and about their points there.

    Raises
    ------
    ConfigError
        No file comes near the area.
    """
    if plan.area is None:
        return plan
    option = "--bounds" if plan.config.aoi is None else f"--aoi {plan.config.aoi}"
    near = [s for s in plan.sources if s.points and plan.area.touches(bounds_of(s).pad(plan.margin))]
    if not near or not plan.area.touches(plan.extent):
        west, south, east, north = (v / COUNTS_PER_UNIT for v in plan.area.bounds.to_json())
        x0, y0, x1, y1 = (v / COUNTS_PER_UNIT for v in plan.extent.to_json())
        raise ConfigError(
            f"{option}: ({west:.10g}, {south:.10g}) to ({east:.10g}, {north:.10g}) holds nothing of the clouds, "
            f"which lie in ({x0:.10g}, {y0:.10g}) to ({x1:.10g}, {y1:.10g}) in units of their CRS"
        )
    left = sum(bool(s.points) for s in plan.sources) - len(near)
    margin = plan.margin / COUNTS_PER_UNIT * float(plan.meta.frame.units.horizontal)
    notes = [
        f"{option}: points within {margin:g} m of it are read as well, so that its border shows in no result"
    ]
    notes += [f"{option}: {left} files lie farther off and are not read"] if left else []
    shares = [_share(plan, source) for source in near]
    points = round(sum(s.points * share for s, share in zip(near, shares, strict=True)))
    whole = [float(bounds_of(s).area()) for s in near]
    part = sum(a * share for a, share in zip(whole, shares, strict=True)) * plan.meta.frame.metres_xy**2
    extent = plan.extent.intersection(plan.area.bounds)
    return dataclasses.replace(
        plan, sources=tuple(near), points=points, area_m2=float(part), extent=extent,
        names={path: name for path, name in plan.names.items() if path in {s.path for s in near}},
        notes=(*plan.notes, *notes),
    )  # fmt: skip


def _share(plan: Plan, source: SourceInfo) -> float:
    """About the part of a source's points that is read."""
    runs = plan.buckets_of(source)
    if runs is None:
        return 1.0
    cells = sum(end - first for _, first, end in runs)
    return min(cells * float(plan.meta.bucket.size) ** 2 / bounds_of(source).area(), 1.0)


def _in_crs(
    path: Path, polygons: list[list[Ring]], text: str | None, wkt: str | None, notes: list[str]
) -> list[list[Ring]]:
    """Rings in the CRS of the run."""
    if text is None and wkt is None:
        notes.append(f"{path}: names no CRS: its polygons are taken to be in that of the clouds")
        return polygons
    if text is None:
        raise InputError(f"{path}: has no CRS; write it with one, `ogr2ogr -a_srs EPSG:... area.gpkg {path}`")
    try:
        named = split(CRS.from_user_input(text))[0]
    except (ProjError, UnicodeError, RecursionError) as error:
        raise InputError(f"{path}: its CRS {excerpt(text)} is not known; write it with another") from error
    if named is None:
        raise InputError(f"{path}: its CRS {excerpt(text)} has no horizontal part; write it with another")
    own = None if wkt is None else split(CRS.from_wkt(wkt))[0]
    if own is None:
        raise InputError(
            f"{path}: is in {named.name}, the CRS of the clouds is unknown; name it with --crs, or use --bounds"
        )
    if same_horizontal(named, own):
        return polygons
    notes.append(f"{path}: its polygons are brought from {named.name} into {own.name}")
    try:
        transformer = Transformer.from_crs(named, own, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"{path}: is in {named.name}, from which no way leads into {own.name}; write it with another CRS"
        ) from error
    near = RETURN_DEG if named.is_geographic else RETURN
    moved = [[_moved(transformer, ring, near) for ring in rings] for rings in polygons]
    if any(ring is None for rings in moved for ring in rings):
        raise InputError(
            f"{path}: its polygons reach where {own.name} has no coordinates; cut them to the survey"
        )
    return [[ring for ring in rings if ring is not None] for rings in moved]


def _moved(transformer: Transformer, ring: Ring, near: float) -> Ring | None:
    """A ring in another CRS; its straight edges are bent there, and get points until each piece is as good as straight.

    An edge is divided in the same way in whatever direction it runs, so that neighbours keep a common border.
    None: some of it does not come back to within ``near``, as beyond the reach of a projection.
    """
    start = ring[:-1] if len(ring) > 1 and (ring[0] == ring[-1]).all() else ring
    there = np.stack(transformer.transform(*start.T), axis=1)
    for _ in range(MOST_HALVINGS):
        back = np.stack(
            transformer.transform(there[:, 0], there[:, 1], direction=TransformDirection.INVERSE), axis=1
        )
        if not (np.isfinite(there).all() and np.allclose(back, start, rtol=0, atol=near)):
            return None
        middle = (start + np.roll(start, -1, axis=0)) / 2
        moved = np.stack(transformer.transform(*middle.T), axis=1)
        chord = (there + np.roll(there, -1, axis=0)) / 2
        bent = np.flatnonzero(np.hypot(*(moved - chord).T) > BEND)
        if not bent.size:
            break
        start = np.insert(start, bent + 1, middle[bent], axis=0)
        there = np.insert(there, bent + 1, moved[bent], axis=0)
    return there if np.isfinite(there).all() else None
