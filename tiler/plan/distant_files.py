"""Search for files so far from the others that one run, or one raster, cannot contain them.

Coordinates alone cannot distinguish wrong coordinates from a second site. So all files are kept
as long as one run can contain them. If one run cannot contain them, the part with most files is
kept. Other files are left out if they are few, or if only the kept part lies in the area of use
of its CRS. Otherwise the run is refused, with a remedy.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
import scipy

from tiler.core.area import Area
from tiler.core.crs import placement
from tiler.core.lattice import COUNTS_PER_UNIT, INT32_LIMIT, Bounds
from tiler.errors import ConfigError
from tiler.inputs import SourceInfo
from tiler.plan.sizes import bounds_of, middle, union_bounds

FRAME = 2 * (INT32_LIMIT - 10_000 * COUNTS_PER_UNIT)
"""Widest extent in counts that fits the frame with room for a halo. The frame's origin is near
its middle."""
PARTS = 16
"""Number of cells along the longer side of the whole extent, on which groups of files are
separated."""
FILES_PER_OUTLIER = 4
"""Minimum ratio of all files to the outlying files, if these are left out because they are
few."""
MAX_DISTANCE_M = 5e7
"""Largest coordinate of any CRS in metres, more than the circumference of the Earth."""
TOLERANCE_DEG = 5.0
"""Tolerance in degrees around the area of use of a CRS, since CRSs are used somewhat beyond
it."""

LeftOut = list[tuple[SourceInfo, str]]


def files_beyond_frame(
    sources: Sequence[SourceInfo], area: Area | None, wkt: str | None, metres: float
) -> LeftOut:
    """Return the files that cannot be in one run with the others, each with the reason.

    Parameters
    ----------
    sources : sequence of SourceInfo
        Files with points.
    area : Area or None
        Area of interest. Files near it are kept.
    wkt : str or None
        CRS of the files.
    metres : float
        Metres per unit of the CRS.

    Raises
    ------
    ConfigError
        It cannot be decided which files to keep.
    """
    left_out: LeftOut = []
    kept: list[SourceInfo] = []
    for source in sources:
        reason = _why_impossible(source, metres)
        if reason is None:
            kept.append(source)
        else:
            left_out.append((source, reason))
    while kept and not _fits(union_bounds(kept)):
        far = _far_from_area(kept, area, metres)
        if not far:
            remedy = "too far for one run; run them separately, or check the coordinates"
            far = outlying_files(kept, wkt, metres, remedy)
        left_out += far
        kept = _without(kept, far)
    return left_out


def _far_from_area(sources: Sequence[SourceInfo], area: Area | None, metres: float) -> LeftOut:
    """Return the files that are not near the area, or none if there is no area or no file is near it."""
    if area is None:
        return []
    near = [s for s in sources if bounds_of(s).overlaps(area.bounds.pad(FRAME // PARTS))]
    if not near:
        return []
    return [
        (s, _reason(s, near, metres, "not near the requested area"))
        for s in sources
        if s not in near
    ]


def outlying_files(
    sources: Sequence[SourceInfo], wkt: str | None, metres: float, remedy: str
) -> LeftOut:
    """Return the files that lie apart from most others, each with a reason that ends with ``remedy``.

    These are the files outside the largest part, if only that part lies in the area of use of
    the CRS. They are also left out if they are few, unless only they lie in that area.
    Otherwise files that are each wider than half of the whole extent are left out if they are
    few.

    Raises
    ------
    ConfigError
        Too many files lie apart, or the files do not form separate parts.
    """

    def rank(part: Sequence[SourceInfo]) -> tuple[int, int, int]:
        return len(part), _in_use(part[0], wkt), sum(source.points for source in part)

    main, *rest = sorted(_parts(sources), key=rank, reverse=True)
    outlying = list(itertools.chain.from_iterable(rest))
    in_use = _in_use(main[0], wkt)
    rest_in_use = max((_in_use(part[0], wkt) for part in rest), default=1)
    few = 0 < FILES_PER_OUTLIER * len(outlying) <= len(sources)
    if in_use > rest_in_use or (in_use == rest_in_use and few):
        return [(s, _reason(s, main, metres, remedy)) for s in outlying]
    span = _span(union_bounds(sources))
    wide = [s for s in sources if 2 * _span(bounds_of(s)) > span]
    if wide and FILES_PER_OUTLIER * len(wide) <= len(sources):
        return [
            (s, f"its points lie up to {_km(bounds_of(s), metres)} apart: {remedy}")
            for s in wide
        ]
    if wide:
        subject = f"{wide[0].path}: its points lie"
    else:

        def north_east(source: SourceInfo) -> int:
            return sum(bounds_of(source).to_json())

        subject = (
            f"{min(sources, key=north_east).path} and {max(sources, key=north_east).path} lie"
        )
    raise ConfigError(f"{subject} up to {_km(union_bounds(sources), metres)} apart: {remedy}")


def _why_impossible(source: SourceInfo, metres: float) -> str | None:
    """Return the reason why no run can contain a file, or None if a run can."""
    bounds = bounds_of(source)
    x, y = bounds.x0 / COUNTS_PER_UNIT, bounds.y0 / COUNTS_PER_UNIT
    if not _fits(bounds):
        return f"its points are up to {_km(bounds, metres)} apart, too far for one survey; check its coordinates"
    if max(map(abs, bounds.to_json())) / COUNTS_PER_UNIT * metres > MAX_DISTANCE_M:
        return f"lies at x {x:.6g}, y {y:.6g}, outside the coordinates of any CRS; check its offsets and scales"
    return None


def _span(bounds: Bounds) -> int:
    return max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0)


def _km(bounds: Bounds, metres: float) -> str:
    return f"{_span(bounds) / COUNTS_PER_UNIT * metres / 1000:,.0f} km"


def _fits(bounds: Bounds) -> bool:
    return _span(bounds) <= FRAME


def _without(sources: Iterable[SourceInfo], far: LeftOut) -> list[SourceInfo]:
    far_paths = {s.path for s, _ in far}
    return [s for s in sources if s.path not in far_paths]


def _reason(
    source: SourceInfo, others: Sequence[SourceInfo], metres: float, remedy: str
) -> str:
    bounds, hull = bounds_of(source), union_bounds(others)
    x, y = bounds.x0 / COUNTS_PER_UNIT, bounds.y0 / COUNTS_PER_UNIT
    dx = max(hull.x0 - bounds.x1, bounds.x0 - hull.x1, 0)
    dy = max(hull.y0 - bounds.y1, bounds.y0 - hull.y1, 0)
    km = math.hypot(dx, dy) / COUNTS_PER_UNIT * metres / 1000
    return f"lies at x {x:.10g}, y {y:.10g}, {km:,.0f} km from the other files: {remedy}"


def _parts(sources: Sequence[SourceInfo]) -> list[list[SourceInfo]]:
    """Divide files into parts that are separated by empty cells.

    The longer side of the extent has `PARTS` cells.
    """
    hull = union_bounds(sources)
    side = _span(hull) // PARTS + 1
    occupied = np.zeros((PARTS, PARTS), np.bool_)
    windows = []
    for bounds in map(bounds_of, sources):
        columns = slice((bounds.x0 - hull.x0) // side, (bounds.x1 - 1 - hull.x0) // side + 1)
        rows = slice((bounds.y0 - hull.y0) // side, (bounds.y1 - 1 - hull.y0) // side + 1)
        occupied[rows, columns] = True
        windows.append((rows, columns))
    numbers = scipy.ndimage.label(occupied, np.ones((3, 3), np.bool_))[0]
    parts: dict[int, list[SourceInfo]] = defaultdict(list)
    for source, window in zip(sources, windows, strict=True):
        parts[int(numbers[window].flat[0])].append(source)
    return list(parts.values())


def _in_use(source: SourceInfo, wkt: str | None) -> int:
    """Return 1 if a file lies in the area of use of its CRS, -1 if it lies elsewhere, 0 if unknown."""
    found = None if wkt is None else placement(wkt, *middle(bounds_of(source)))
    if found is None:
        return 0
    return 1 if found.outside_deg <= TOLERANCE_DEG else -1
