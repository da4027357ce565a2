"""Inspection of the inputs in several processes, what made the clouds, and files that are left out.

One run, or one raster, cannot contain files that lie too far apart. Coordinates alone cannot
distinguish wrong coordinates from a second site. So all files are kept as long as one run can
contain them. If one run cannot contain them, the part with most files is kept. Other files are
left out if they are few, or if only the kept part lies in the area of use of its CRS. Otherwise
the run is refused, with a remedy.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path

import numpy as np
import scipy

from ptd.matched.evidence import Evidence, Finding, decided_by
from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.crs import placement
from tiler.core.lattice import COUNTS_PER_UNIT, INT32_LIMIT, Bounds
from tiler.errors import ConfigError, InputError
from tiler.inputs import CommonCrs, SourceInfo, inspect, inspect_in_child, is_list
from tiler.io.cloud_formats import SUFFIXES
from tiler.io.locations import as_path, is_url, without_query
from tiler.io.result_folder import COPC_SUFFIX
from tiler.plan import sizes
from tiler.plan.memory import default_workers
from tiler.plan.method import KIND_WORDS
from tiler.plan.model import Inputs, filled_sources
from tiler.plan.sizes import DensityMap, bounds_of, middle, union_bounds
from tiler.schedule import FORKS, ChildPool

FRAME = 2 * (INT32_LIMIT - 10_000 * COUNTS_PER_UNIT)
"""Widest extent in counts that fits the frame with room for a halo. The frame's origin is near
its middle."""
EXTENT_CELLS = 16
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

MIN_SHARE = 0.01
"""Smallest share of the area that clouds of one writer must cover for their kind to count."""

FILES_PER_READER = 2 if FORKS else 16
"""Number of inputs per reading process. Starting a process takes as long as inspecting this
many inputs."""
MAX_URL_READERS = 8
"""Maximum number of processes that inspect objects at URLs. There may be more of them than
cores, because they mostly wait for responses."""


def inspect_all(
    paths: Sequence[Path], config: RunConfig, known: Sequence[SourceInfo]
) -> tuple[list[SourceInfo], list[tuple[str, str]]]:
    """Return the files that can be read, and path and reason of each other file."""
    known_by_path = {str(source.path): source for source in known}
    if known_by_path and all(str(path) in known_by_path for path in paths):
        return [known_by_path[str(path)] for path in paths], []
    sources: list[SourceInfo] = []
    left_out: list[tuple[str, str]] = []
    with ChildPool(reading_processes(paths, config)) as children:
        results: Iterable[Callable[[], SourceInfo]]
        if config.in_process:
            results = (partial(inspect, path, config.salvage) for path in paths)
        else:
            results = children.each(partial(inspect_in_child, salvage=config.salvage), paths)
        for path, result in zip(paths, results, strict=True):
            try:
                sources.append(result())
            except InputError as error:
                if config.on_error == "stop" or len(paths) == 1:
                    raise
                left_out.append((str(path), str(error)))
    if not sources:
        raise InputError(
            f"none of {len(paths)} inputs can be read; the first error: {left_out[0][1]}"
        )
    return sources, left_out


def reading_processes(paths: Sequence[Path], config: RunConfig) -> int:
    """Return the number of processes that inspect the inputs.

    Each process except the last has at least `FILES_PER_READER` inputs, because starting a
    process takes time.
    """
    n_urls = sum(is_url(path) for path in paths)
    workers = config.workers or default_workers()
    for_files = min(workers, math.ceil((len(paths) - n_urls) / FILES_PER_READER))
    for_urls = min(MAX_URL_READERS, math.ceil(n_urls / FILES_PER_READER))
    return max(for_files, for_urls, 1)


@dataclass(frozen=True, kw_only=True)
class InspectedInputs:
    """Inputs that can be read, inputs that are left out, and the common CRS."""

    given: Sequence[str]
    sources: Sequence[SourceInfo]
    left_out: Sequence[tuple[str, str]]
    crs: CommonCrs
    area: Area | None
    notes: Sequence[str]

    @cached_property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return filled_sources(self.sources)

    @cached_property
    def density_map(self) -> DensityMap:
        """Density map of the sources' points."""
        patches = chain.from_iterable(source.patches for source in self.filled)
        return DensityMap(patches, float(self.crs.units.horizontal))

    @cached_property
    def covered(self) -> tuple[float, tuple[str, ...]]:
        """Area in m2 that the sources' points cover, and the notes on how it was determined."""
        notes: list[str] = []
        bounds = [s.bounds for s in self.filled if s.bounds is not None]
        points = sum(s.points for s in self.filled)
        metres = float(self.crs.units.horizontal)
        return sizes.covered_m2(bounds, points, self.density_map, metres, notes), tuple(notes)

    def without(self, far: LeftOut, config: RunConfig) -> InspectedInputs:
        """Return the inputs without the files that lie too far away.

        Raise InputError if the run stops on errors or no points would be left.
        """
        if not far:
            return self
        reasons = {source.path: f"{source.path}: {reason}" for source, reason in far}
        kept = [source for source in self.sources if source.path not in reasons]
        if config.on_error == "stop" or not filled_sources(kept):
            raise InputError(next(iter(reasons.values())))
        left_out = [*self.left_out, *((str(path), reason) for path, reason in reasons.items())]
        return replace(self, sources=kept, left_out=left_out)

    def planned(self, suffix: str) -> Inputs:
        """Return the inputs of the plan. Names of classified clouds end with ``suffix``."""
        return Inputs(
            sources=tuple(self.sources),
            left_out=tuple(self.left_out),
            area=self.area,
            points=sum(s.points for s in self.filled),
            covered_m2=self.covered[0],
            extent=sizes.union_bounds(self.filled),
            density_map=self.density_map,
            cloud_names=output_names(self.given, self.sources, suffix),
            evidence=evidence_of(self.filled),
        )


def output_names(
    inputs: Sequence[str], sources: Iterable[SourceInfo], suffix: str = ".laz"
) -> dict[Path, Path]:
    """Return the path of each classified file relative to OUT/classified.

    Raise ConfigError if two files would have the same path.
    """
    folders = []
    for text in inputs:
        path = as_path(text)
        if is_list(text) and not Path(text).is_dir():
            folders.append(path.parent)
        elif is_url(path) or path.is_dir():
            folders.append(path)
    names: dict[Path, Path] = {}
    taken: dict[str, Path] = {}
    for source in sources:
        path = source.path
        if is_url(path):
            # A query can hold a token, which must not become part of a name.
            path = as_path(without_query(str(path)))
        name = Path(path.name)
        for folder in folders:
            # A URL among the folders may be the source itself, whose path relative to it would
            # be empty.
            same_kind = type(folder) is type(path)
            if same_kind and folder != path and path.is_relative_to(folder):
                name = Path(str(path.relative_to(folder)))
                break
        # What follows the dot of another name, like "2" in "tile.2", may tell files apart.
        is_cloud = name.suffix.lower().partition("?")[0] in SUFFIXES
        stem = name.stem if is_cloud else name.name
        if source.copc or suffix == COPC_SUFFIX:
            stem = stem.removesuffix(".copc")
        name = name.with_name(f"{stem}{suffix}")
        if str(name).lower() in taken:
            raise ConfigError(
                f"{source.path} and {taken[str(name).lower()]} would both become classified/{name}; "
                "rename one of them, or give a folder that contains both in different subfolders"
            )
        taken[str(name).lower()] = source.path
        names[source.path] = name
    return names


def evidence_of(sources: Sequence[SourceInfo]) -> Evidence:
    """Merge the evidence of all files, weighted by area.

    The result does not depend on how a survey is cut into files.
    """
    return Evidence.merged((source.evidence, _area(source)) for source in sources)


def validate_single_kind(sources: Sequence[SourceInfo], config: RunConfig) -> None:
    """Raise ConfigError if a run without `--kind` mixes LiDAR and photogrammetric clouds.

    Files of one writer are judged together, because a small piece of a survey may lack the
    evidence.
    """
    if config.source_kind is not None:
        return
    writers: dict[tuple[object, ...], list[SourceInfo]] = defaultdict(list)
    for source in sources:
        writers[
            source.version, source.point_format, source.record_length, source.scales
        ].append(source)
    whole = sum(map(_area, sources))
    findings: dict[str, tuple[Finding, SourceInfo]] = {}
    for files in writers.values():
        finding = decided_by(evidence_of(files))
        if finding is not None and sum(map(_area, files)) >= MIN_SHARE * whole:
            findings.setdefault(finding.kind, (finding, files[0]))
    if len(findings) < 2:
        return
    raise ConfigError(
        f"{_in_words(findings.values())}: a run needs clouds of one kind; run them separately, or use --kind als or dim"
    )


def _in_words(findings: Iterable[tuple[Finding, SourceInfo]]) -> str:
    texts = []
    for finding, source in findings:
        certainty = f"{100 * (finding.sure or 0):.0f} % sure"
        texts.append(
            f"{source.path} is {KIND_WORDS[finding.kind]} ({certainty}: {finding.why})"
        )
    return " and ".join(texts)


def _area(source: SourceInfo) -> float:
    """Return the area of a source's patches in square units of the CRS, or 1 if it is empty."""
    return sum((p.x1 - p.x0) * (p.y1 - p.y0) for p in source.patches) or 1.0


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
        far_paths = {s.path for s, _ in far}
        kept = [s for s in kept if s.path not in far_paths]
    return left_out


def _far_from_area(sources: Sequence[SourceInfo], area: Area | None, metres: float) -> LeftOut:
    """Return the files that are not near the area, or none if there is no area or no file is near it."""
    if area is None:
        return []
    near = [s for s in sources if bounds_of(s).overlaps(area.bounds.pad(FRAME // EXTENT_CELLS))]
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
    outlying = list(chain.from_iterable(rest))
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

    The longer side of the extent has `EXTENT_CELLS` cells.
    """
    hull = union_bounds(sources)
    side = _span(hull) // EXTENT_CELLS + 1
    occupied = np.zeros((EXTENT_CELLS, EXTENT_CELLS), np.bool_)
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
