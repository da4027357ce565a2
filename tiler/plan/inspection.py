"""Inspection of the inputs in several processes, and values that follow from all of their headers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path

from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.errors import ConfigError, InputError
from tiler.inputs import CommonCrs, SourceInfo, inspect, inspect_in_child, is_list
from tiler.io.locations import as_path, is_url, without_query
from tiler.io.result_folder import CLOUD_SUFFIXES, COPC_SUFFIX
from tiler.plan import machine, sizes
from tiler.plan.density_map import DensityMap
from tiler.plan.distant_files import LeftOut
from tiler.plan.inputs import Inputs, filled_sources
from tiler.plan.made_by import evidence_of
from tiler.schedule import FORKS, ChildPool

FILES_PER_READER = 2 if FORKS else 16
"""Number of inputs per reading process. Starting a process takes as long as inspecting this
many inputs."""
MAX_URL_READERS = 8
"""Maximum number of processes that inspect objects at URLs. There may be more of them than
cores, because they mostly wait for responses."""


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
    workers = config.workers or machine.default_workers()
    for_files = min(workers, math.ceil((len(paths) - n_urls) / FILES_PER_READER))
    for_urls = min(MAX_URL_READERS, math.ceil(n_urls / FILES_PER_READER))
    return max(for_files, for_urls, 1)


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
        is_cloud = name.suffix.lower().partition("?")[0] in CLOUD_SUFFIXES.values()
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
