"""Finds files so far from all others that one run, or one raster, cannot hold them together.

Nobody can tell absurd coordinates from a second site by the numbers alone. So nothing is left out while all of it can
be done. Where it cannot, the part with most files is what the run is about, and others are left out if they are few
or lie where their CRS is not used; else the run is refused, with what would do both.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
import scipy
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from tiler.core.area import Area
from tiler.core.frame import COUNTS_PER_UNIT, INT32_LIMIT
from tiler.core.lattice import Bounds
from tiler.errors import ConfigError
from tiler.ingest import SourceInfo
from tiler.plan.sizes import bounds_of, hull_of

FRAME = 2 * (INT32_LIMIT - 10_000 * COUNTS_PER_UNIT)
"""Counts across which coordinates fit the frame, whose origin is the middle on a round number; a halo has room."""
PARTS = 16
"""Groups of files are separated on a lattice with so many cells along the longer side of all."""
FEW = 4
"""What is left out is at most the fourth part of all files."""
FARTHEST_M = 5e7
"""No CRS has coordinates beyond: more than once around the Earth."""
BESIDE_DEG = 5.0
"""Degrees beyond the area of use of a CRS within which it may well be used."""

LeftOut = list[tuple[SourceInfo, str]]


def beyond_frame(sources: Sequence[SourceInfo], area: Area | None, wkt: str | None, metres: float) -> LeftOut:
    """Files that cannot be in one run with the others, each with the reason.

    Parameters
    ----------
    sources : sequence of SourceInfo
        With points.
    area : Area or None
        Of the run: files that come near it are what the run is about.
    wkt : str or None
        Their CRS.
    metres : float
        Of its unit.

    Raises
    ------
    ConfigError
        There is no saying which of them it is about.
    """
    absurd = [(s, _absurd(s, metres)) for s in sources]
    found = [(s, reason) for s, reason in absurd if reason]
    left = [s for s, reason in absurd if not reason]
    while left and not _fits(hull_of(left)):
        if area is not None:
            near = [s for s in left if bounds_of(s).overlaps(area.bounds.pad(FRAME // PARTS))]
            if near and len(near) < len(left):
                far = [
                    (s, _reason(s, near, metres, "not near the area that is wanted"))
                    for s in left
                    if s not in near
                ]
                found, left = found + far, near
                continue
        remedy = "farther than one run can hold; run on each of them alone, or see to their coordinates"
        far = minority(left, wkt, metres, remedy)
        found, left = found + far, _without(left, far)
    return found


def minority(sources: Sequence[SourceInfo], wkt: str | None, metres: float, remedy: str) -> LeftOut:
    """The files that lie apart from most, each with the reason, which ends with ``remedy``.

    Raises
    ------
    ConfigError
        They are too many to be left out, or lie in no parts.
    """
    ranked = [
        (len(part), _in_use(part[0], wkt), sum(s.points for s in part), part) for part in _parts(sources)
    ]
    (_, used, _, main), *rest = sorted(ranked, key=lambda entry: entry[:3], reverse=True)
    others, elsewhere = [s for *_, part in rest for s in part], max((entry[1] for entry in rest), default=1)
    if used > elsewhere or (others and used == elsewhere and FEW * len(others) <= len(sources)):
        return [(s, _reason(s, main, metres, remedy)) for s in others]
    span = _span(hull_of(sources))
    wide = [s for s in sources if 2 * _span(bounds_of(s)) > span]
    if wide and FEW * len(wide) <= len(sources):
        return [
            (s, f"its points lie up to {_km(bounds_of(s), metres)} from one another: {remedy}") for s in wide
        ]
    ends = wide[:1] or [pick(sources, key=lambda s: sum(bounds_of(s).to_json())) for pick in (min, max)]
    named = " and ".join(str(s.path) for s in ends) + (": its points lie" if wide else " lie")
    raise ConfigError(f"{named} up to {_km(hull_of(sources), metres)} from one another: {remedy}")


def _absurd(source: SourceInfo, metres: float) -> str | None:
    """Reason why no run can hold a file, or None."""
    bounds = bounds_of(source)
    x, y = bounds.x0 / COUNTS_PER_UNIT, bounds.y0 / COUNTS_PER_UNIT
    if not _fits(bounds):
        return (
            f"its points lie up to {_km(bounds, metres)} from one another, no survey; see to its coordinates"
        )
    if max(map(abs, bounds.to_json())) / COUNTS_PER_UNIT * metres > FARTHEST_M:
        return f"lies at x {x:.6g}, y {y:.6g}, where no CRS has coordinates; see to its offsets and scales"
    return None


def _span(bounds: Bounds) -> int:
    return max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0)


def _km(bounds: Bounds, metres: float) -> str:
    return f"{_span(bounds) / COUNTS_PER_UNIT * metres / 1000:,.0f} km"


def _fits(bounds: Bounds) -> bool:
    return _span(bounds) <= FRAME


def _without(sources: Iterable[SourceInfo], far: LeftOut) -> list[SourceInfo]:
    gone = {s.path for s, _ in far}
    return [s for s in sources if s.path not in gone]


def _reason(source: SourceInfo, others: Sequence[SourceInfo], metres: float, remedy: str) -> str:
    bounds, hull = bounds_of(source), hull_of(others)
    x, y = bounds.x0 / COUNTS_PER_UNIT, bounds.y0 / COUNTS_PER_UNIT
    aside = max(hull.x0 - bounds.x1, bounds.x0 - hull.x1, 0)
    along = max(hull.y0 - bounds.y1, bounds.y0 - hull.y1, 0)
    away = math.hypot(aside, along) / COUNTS_PER_UNIT * metres / 1000
    return f"lies at x {x:.10g}, y {y:.10g}, {away:,.0f} km from the other files: {remedy}"


def _parts(sources: Sequence[SourceInfo]) -> list[list[SourceInfo]]:
    """Files in parts between which there is an empty cell, of `PARTS` along the longer side of all."""
    hull = hull_of(sources)
    side = _span(hull) // PARTS + 1
    held, windows = np.zeros((PARTS, PARTS), np.bool_), []
    for bounds in map(bounds_of, sources):
        columns = slice((bounds.x0 - hull.x0) // side, (bounds.x1 - 1 - hull.x0) // side + 1)
        rows = slice((bounds.y0 - hull.y0) // side, (bounds.y1 - 1 - hull.y0) // side + 1)
        held[rows, columns] = True
        windows.append((rows, columns))
    numbers = scipy.ndimage.label(held, np.ones((3, 3), np.bool_))[0]
    parts: dict[int, list[SourceInfo]] = defaultdict(list)
    for source, window in zip(sources, windows, strict=True):
        parts[int(numbers[window].flat[0])].append(source)
    return list(parts.values())


def _in_use(source: SourceInfo, wkt: str | None) -> int:
    """1 if a file lies where its CRS is used, -1 if elsewhere, 0 if nobody knows."""
    if wkt is None:
        return 0
    try:
        crs = CRS.from_wkt(wkt)
        use = crs.area_of_use or (crs.sub_crs_list[0].area_of_use if crs.sub_crs_list else None)
        if use is None or crs.geodetic_crs is None:
            return 0
        bounds = bounds_of(source)
        x, y = ((a + b) / 2 / COUNTS_PER_UNIT for a, b in ((bounds.x0, bounds.x1), (bounds.y0, bounds.y1)))
        transformer = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
        east, north = transformer.transform(x, y)
        back = transformer.transform(east, north, direction="INVERSE")
    except (CRSError, ProjError):
        return 0
    if not all(map(math.isfinite, (east, north, *back))) or math.dist(back, (x, y)) > 1:
        return -1
    width = (use.east - use.west) % 360 or 360
    within = (east - use.west + BESIDE_DEG) % 360 <= width + 2 * BESIDE_DEG
    return 1 if within and use.south - BESIDE_DEG <= north <= use.north + BESIDE_DEG else -1
