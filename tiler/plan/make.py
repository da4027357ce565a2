"""Making of the plan from the headers of the inputs and the settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Any

from ptd.matched.evidence import decided_by
from ptd.methods import METHODS, make_params
from ptd.params import to_json
from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.core.units_text import in_unit_of_crs
from tiler.errors import ConfigError, InputError
from tiler.inputs import (
    CommonCrs,
    SourceInfo,
    find_inputs,
    inspect,
    inspect_in_child,
    is_list,
    resolve_common_crs,
)
from tiler.io.locations import as_path, is_url
from tiler.io.result_folder import CLOUD_SUFFIXES, COPC_SUFFIX, earlier_statistics
from tiler.plan import advice, machine, sizes
from tiler.plan.area import area_of, part_of
from tiler.plan.density_map import DensityMap
from tiler.plan.disk import sparse_raster_remedy, sparse_raster_warning
from tiler.plan.distant_files import LeftOut, files_beyond_frame, outlying_files
from tiler.plan.doubtful import warnings_of
from tiler.plan.drawings import with_user_features
from tiler.plan.ept_nodes import EptInputs, validate_distances
from tiler.plan.equivalents import EQUIVALENTS
from tiler.plan.feet import bare_lengths, with_survey_feet
from tiler.plan.halos import default_halo_m, planned_passes
from tiler.plan.made_by import evidence_of, validate_single_kind
from tiler.plan.memory import fine_cell_m
from tiler.plan.model import KEEP, Plan, expected_passes, known_kind, steps_of
from tiler.plan.validation import (
    validate,
    validate_output_paths,
    validate_pixel_count,
    validate_resolution,
    validate_targets,
)
from tiler.schedule import FORKS, ChildPool
from tiler.store import StoreMeta

FILES_PER_READER = 2 if FORKS else 16
"""Number of inputs per reading process. Starting a process takes as long as inspecting this many inputs."""
MAX_URL_READERS = 8
"""Maximum number of processes that inspect objects at URLs. There may be more of them than cores, because they mostly
wait for responses."""


def make_plan(
    inputs: Sequence[str],
    config: RunConfig,
    out: str | Path | None = None,
    known: Sequence[SourceInfo] = (),
) -> Plan:
    """Read the headers, and decide CRS, units, method and sizes of a run.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs.
    config : RunConfig
    out : path or URL, optional
        Folder or URL of the run's results. Files that no run wrote are not replaced unless the run is forced, and the
        free space of a folder is checked.
    known : sequence of SourceInfo
        Headers of the inputs that were read shortly before. If they include all inputs, none is read again.

    Raises
    ------
    ConfigError
        Settings cannot work: method, parameters, memory, disk.
    InputError
        No input can be read, or a CRS cannot be used.
    """
    parameters, defaults = _method(config)
    notes: list[str] = []
    folder = None if out is None or is_url(out) else Path(out)
    ept = EptInputs(config)
    paths = find_inputs(inputs, folder, notes.append, False, ept.node_filter, ept.record, config.in_process)
    if out is not None:
        validate_output_paths(config, str(out), paths)
    sources, unreadable = _inspect_all(paths, config, known)
    sources = ept.with_crs(sources, notes)
    crs = resolve_common_crs(sources, config)
    notes += crs.notes
    config = with_survey_feet(config, crs.units)
    notes += bare_lengths(config, crs.units)
    for source in sources:
        notes += [f"{source.path}: {text}" for text in source.notes]
    if not _filled(sources):
        raise InputError(f"{_names(sources)}: no points to make a terrain from; give clouds with points")
    area = area_of(config, crs.wkt, notes)
    inspected = _InspectedInputs(inputs, sources, unreadable, crs, area, notes)
    metres = float(crs.units.horizontal)
    inspected = _without(inspected, files_beyond_frame(_filled(sources), area, crs.wkt, metres), config)
    plan = _plan_for(inspected, config, parameters, defaults)
    validate_resolution(plan)  # This comes first, so that bad pixels are not reported as a large raster.
    validate_pixel_count(plan, folder)
    while remedy := sparse_raster_remedy(plan, folder):
        inspected = _without(inspected, outlying_files(plan.filled, crs.wkt, metres, remedy), config)
        plan = _plan_for(inspected, config, parameters, defaults)
    validate_distances(plan, inputs)
    plan = with_user_features(plan)

    def replan(**values: Any) -> Plan:
        other = _plan_for(inspected, config.updated(**values), parameters, defaults)
        return replace(other, edits=plan.edits, lines=plan.lines, waters=plan.waters)

    validate(plan, folder, replan)
    if out is not None:
        validate_targets(plan, str(out), paths)
    return plan


@dataclass(frozen=True)
class _InspectedInputs:
    """Inputs that can be read, inputs that are left out, and the common CRS."""

    inputs: Sequence[str]
    sources: Sequence[SourceInfo]
    unreadable: Sequence[tuple[str, str]]
    crs: CommonCrs
    area: Area | None
    notes: Sequence[str]

    @cached_property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return _filled(self.sources)

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


def _filled(sources: Sequence[SourceInfo]) -> list[SourceInfo]:
    return [s for s in sources if s.points and s.bounds is not None]


def _without(inspected: _InspectedInputs, far: LeftOut, config: RunConfig) -> _InspectedInputs:
    """Remove the files that lie too far away.

    Raise InputError if the run stops on errors or no points would be left.
    """
    if not far:
        return inspected
    reasons = {source.path: f"{source.path}: {reason}" for source, reason in far}
    kept = [source for source in inspected.sources if source.path not in reasons]
    if config.on_error == "stop" or not _filled(kept):
        raise InputError(next(iter(reasons.values())))
    unreadable = [*inspected.unreadable, *((str(path), reason) for path, reason in reasons.items())]
    return replace(inspected, sources=kept, unreadable=unreadable)


def _plan_for(
    inspected: _InspectedInputs, config: RunConfig, parameters: dict[str, Any], defaults: Any
) -> Plan:
    """Return the plan for the inspected files. Memory, disk and sizes are validated later."""
    covered, area_notes = inspected.covered
    notes = [*inspected.notes, *area_notes]
    filled = inspected.filled
    units = inspected.crs.units
    extent = sizes.union_bounds(filled)
    frame = CoordFrame(units, sizes.origin_of(extent), inspected.crs.wkt)
    points = sum(s.points for s in filled)
    density = points / covered
    workers = config.workers or machine.default_workers()
    if config.workers is None and workers < machine.cores():
        mib = machine.memory_bytes() >> 20
        notes.append(
            f"decided: {workers} workers for {machine.cores()} cores, because the memory is {mib:,} MiB (--workers)"
        )
    memory = config.memory or machine.fair_share(workers)
    bucket = sizes.bucket_m(density, inspected.density_map, memory)
    if inspected.area is not None and any(is_url(s.path) and s.octree is not None for s in filled):
        bucket = min(bucket, sizes.FETCHED_BUCKET_M)
    cell = defaults.candidate_cell_m if defaults else 0.0
    colours = defaults is not None and "rgb" in METHODS[config.method].needs
    meta = StoreMeta(
        frame=frame,
        bucket=Lattice(frame.counts(Fraction(bucket))),
        fine=Lattice(frame.counts(fine_cell_m(cell, Fraction(bucket)))),
        has_rgb=colours and any(s.has_rgb for s in filled),
    )
    if colours and not meta.has_rgb:
        raise ConfigError(
            f"--method {config.method}: needs colours (RGB), but no input has them; use another method"
        )
    known = None
    if config.statistics is not None:
        known = earlier_statistics(Path(config.statistics), config.method, parameters)
    evidence = evidence_of(filled) if defaults else None
    kind = known_kind(config, known, evidence)
    passes = planned_passes(defaults, config, kind, notes) if defaults else ()
    steps = steps_of(passes, kind)
    tile = config.tile_size or sizes.tile_m(
        memory, density, cell, expected_passes(steps, kind, density), meta
    )
    resolution = sizes.resolution_of(config, density, kind, units.horizontal, notes)
    plan = Plan(
        config=config,
        sources=tuple(inspected.sources),
        unreadable=tuple(inspected.unreadable),
        meta=meta,
        area=inspected.area,
        parameters=parameters,
        resolution=resolution,
        tile=tile,
        passes=passes,
        memory=memory,
        tile_memory=memory,
        workers=workers,
        candidate_cell_m=cell,
        points=points,
        area_m2=covered,
        extent=extent,
        density_map=inspected.density_map,
        names=output_names(inspected.inputs, inspected.sources, CLOUD_SUFFIXES[config.classified]),
        notes=tuple(notes),
        statistics=known,
        tile_workers=0 if config.tile_size else workers,
        evidence=evidence,
    )
    if known is None and plan.depends_on_kind:
        validate_single_kind(filled, config)
    finding = decided_by(evidence) if evidence else None
    advised = advice.preflight_warnings(config, finding, density, default_halo_m(defaults), units.horizontal)
    plan = part_of(replace(plan, warnings=(*warnings_of(plan), *advised)))
    text = sparse_raster_warning(plan)
    warnings = plan.warnings if text is None else (*plan.warnings, text)
    return replace(
        plan,
        notes=tuple(in_unit_of_crs(text, units) for text in plan.notes),
        warnings=tuple(in_unit_of_crs(text, units) for text in warnings),
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
        name = Path(source.path.name)
        for folder in folders:
            # A URL may be a folder or the source itself, whose relative path would be empty.
            same_kind = type(folder) is type(source.path)
            if same_kind and folder != source.path and source.path.is_relative_to(folder):
                name = Path(str(source.path.relative_to(folder)))
                break
        stem = name.name[: -len(name.suffix)]
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


def _method(config: RunConfig) -> tuple[dict[str, Any], Any]:
    """Return the parameters of the method, as plain values and as a dataclass, or ({}, None) for `keep`."""
    if config.method == KEEP:
        if config.parameters:
            raise ConfigError(f"--set {config.parameters[0][0]}: method keep has no parameters; leave it out")
        if not config.ground_classes:
            raise ConfigError(
                "--ground-classes none: method keep needs the classes of the ground; give at least one, such as 2"
            )
        return {}, None
    if config.method not in METHODS:
        known = EQUIVALENTS.get(config.method.lower(), "does not exist; ")
        raise ConfigError(f"--method {config.method}: {known}use one of {', '.join([*METHODS, KEEP])}")
    try:
        params = make_params(config.method, dict(config.parameters))
    except ValueError as error:
        raise ConfigError(f"--set {error} (method {config.method})") from error
    return to_json(params), params


def _names(sources: Sequence[SourceInfo]) -> str:
    return f"{sources[0].path}" + (f" and {len(sources) - 1} more files" if len(sources) > 1 else "")


def _inspect_all(
    paths: Sequence[Path], config: RunConfig, known: Sequence[SourceInfo]
) -> tuple[list[SourceInfo], list[tuple[str, str]]]:
    """Return the files that can be read, and path and reason of each other file."""
    known_by_path = {str(source.path): source for source in known}
    if known_by_path and all(str(path) in known_by_path for path in paths):
        return [known_by_path[str(path)] for path in paths], []
    sources: list[SourceInfo] = []
    unreadable: list[tuple[str, str]] = []
    with ChildPool(_readers(paths, config)) as children:
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
                unreadable.append((str(path), str(error)))
    if not sources:
        raise InputError(f"none of {len(paths)} inputs can be read; the first error: {unreadable[0][1]}")
    return sources, unreadable


def _readers(paths: Sequence[Path], config: RunConfig) -> int:
    """Return the number of processes that inspect the inputs.

    Each process except the last has at least `FILES_PER_READER` inputs, because starting a process takes time.
    """
    n_urls = sum(is_url(path) for path in paths)
    workers = config.workers or machine.default_workers()
    for_files = min(workers, math.ceil((len(paths) - n_urls) / FILES_PER_READER))
    for_urls = min(MAX_URL_READERS, math.ceil(n_urls / FILES_PER_READER))
    return max(for_files, for_urls, 1)
