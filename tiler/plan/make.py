"""Making of the plan from the headers of the inputs and the settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
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
from tiler.plan.drawings import with_drawings
from tiler.plan.ept_nodes import TilesOfRun, validate_distances
from tiler.plan.equivalents import EQUIVALENTS
from tiler.plan.feet import bare_lengths, in_feet_of
from tiler.plan.halos import own_halo, planned_passes
from tiler.plan.made_by import evidence_of, validate_single_kind
from tiler.plan.memory import fine_cell_m
from tiler.plan.model import KEEP, Plan, known_kind, likely_of, steps_of
from tiler.plan.validation import (
    validate,
    validate_output_paths,
    validate_pixel_count,
    validate_resolution,
    validate_targets,
)
from tiler.schedule import FORKS, ChildPool
from tiler.store import StoreMeta

FILES_OF_A_READER = 2 if FORKS else 16
"""Number of inputs per reading process. Starting a process takes as long as inspecting this many inputs."""
FAR_READERS = 8
"""Maximum number of processes that inspect objects at URLs. It may exceed the number of cores, because the processes
mostly wait for responses."""


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
    tiles = TilesOfRun(config)
    paths = find_inputs(inputs, folder, notes.append, False, tiles.wanted, tiles.listed, config.in_process)
    if out is not None:
        validate_output_paths(config, str(out), paths)
    sources, unreadable = _inspect_all(paths, config, known)
    sources = tiles.with_crs(sources, notes)
    agreement = resolve_common_crs(sources, config)
    notes += agreement.notes
    config = in_feet_of(config, agreement.units)
    notes += bare_lengths(config, agreement.units)
    notes += [f"{s.path}: {text}" for s in sources for text in s.notes]
    if not _filled(sources):
        raise InputError(f"{_names(sources)}: no points to make a terrain from; give clouds with points")
    area = area_of(config, agreement.wkt, notes)
    inspected = _InspectedInputs(inputs, sources, unreadable, agreement, area, notes)
    metres = float(agreement.units.horizontal)
    inspected = _without(inspected, files_beyond_frame(_filled(sources), area, agreement.wkt, metres), config)
    plan = _settled(inspected, config, parameters, defaults)
    validate_resolution(plan)  # This comes first, so that bad pixels are not reported as a large raster.
    validate_pixel_count(plan, folder)
    while remedy := sparse_raster_remedy(plan, folder):
        inspected = _without(inspected, outlying_files(plan.filled, agreement.wkt, metres, remedy), config)
        plan = _settled(inspected, config, parameters, defaults)
    validate_distances(plan, inputs)
    plan = with_drawings(plan)

    def changed(**values: Any) -> Plan:
        other = _settled(inspected, config.updated(**values), parameters, defaults)
        return replace(other, edits=plan.edits, lines=plan.lines, waters=plan.waters)

    validate(plan, folder, changed)
    if out is not None:
        validate_targets(plan, str(out), paths)
    return plan


@dataclass(frozen=True)
class _InspectedInputs:
    """Inputs that can be read, inputs that are left out, and the common CRS."""

    inputs: Sequence[str]
    sources: Sequence[SourceInfo]
    unreadable: Sequence[tuple[str, str]]
    agreement: CommonCrs
    area: Area | None
    notes: Sequence[str]

    @cached_property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return _filled(self.sources)

    @cached_property
    def density_map(self) -> DensityMap:
        """Density map of their points."""
        metres = float(self.agreement.units.horizontal)
        return DensityMap((patch for s in self.filled for patch in s.patches), metres)

    @cached_property
    def covered(self) -> tuple[float, tuple[str, ...]]:
        """Area in m2 that their points cover, and the notes on how it was determined."""
        notes: list[str] = []
        bounds = [s.bounds for s in self.filled if s.bounds is not None]
        points, metres = sum(s.points for s in self.filled), float(self.agreement.units.horizontal)
        return sizes.covered_m2(bounds, points, self.density_map, metres, notes), tuple(notes)


def _filled(sources: Sequence[SourceInfo]) -> list[SourceInfo]:
    return [s for s in sources if s.points and s.bounds is not None]


def _without(found: _InspectedInputs, far: LeftOut, config: RunConfig) -> _InspectedInputs:
    """Remove the files that lie too far away.

    Raise InputError if the run stops on errors or no points would be left.
    """
    if not far:
        return found
    gone = {source.path: f"{source.path}: {reason}" for source, reason in far}
    left = [source for source in found.sources if source.path not in gone]
    if config.on_error == "stop" or not _filled(left):
        raise InputError(next(iter(gone.values())))
    unreadable = [*found.unreadable, *((str(path), reason) for path, reason in gone.items())]
    return replace(found, sources=left, unreadable=unreadable)


def _settled(found: _InspectedInputs, config: RunConfig, parameters: dict[str, Any], defaults: Any) -> Plan:
    """Return the plan for the inspected files. Memory, disk and sizes are validated later."""
    covered, decided = found.covered
    notes, agreement, filled = [*found.notes, *decided], found.agreement, found.filled
    extent = sizes.hull_of(filled)
    frame = CoordFrame(agreement.units, sizes.origin_of(extent), agreement.wkt)
    points = sum(s.points for s in filled)
    density = points / covered
    workers = config.workers or machine.default_workers()
    if config.workers is None and workers < machine.cores():
        mib = machine.memory_bytes() >> 20
        notes.append(
            f"decided: {workers} workers for {machine.cores()} cores, because the memory is {mib:,} MiB (--workers)"
        )
    memory = config.memory or machine.fair_share(workers)
    bucket = sizes.bucket_m(density, found.density_map, memory)
    if found.area is not None and any(is_url(s.path) and s.octree is not None for s in filled):
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
    tile = config.tile_size or sizes.tile_m(memory, density, cell, likely_of(steps, kind, density), meta)
    plan = Plan(
        config, tuple(found.sources), tuple(found.unreadable), meta, found.area, parameters,
        sizes.resolution_of(config, density, kind, agreement.units.horizontal, notes), tile, passes, memory, memory,
        workers, cell, points, covered, extent, found.density_map, None,
        output_names(found.inputs, found.sources, CLOUD_SUFFIXES[config.classified]), tuple(notes),
        statistics=known, tile_workers=0 if config.tile_size else workers, evidence=evidence,
    )  # fmt: skip
    if known is None and plan.asks_kind:
        validate_single_kind(filled, config)
    made, unit = decided_by(evidence) if evidence else None, agreement.units.horizontal
    advised = advice.before(config, made, density, own_halo(defaults), unit)
    plan = part_of(replace(plan, warnings=(*warnings_of(plan), *advised)))
    text = sparse_raster_warning(plan)
    warnings = plan.warnings if text is None else (*plan.warnings, text)
    units = agreement.units
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
    # A URL is a folder or a single object. The relative path of a single object would be empty.
    named = [(as_path(i), is_list(i) and not Path(i).is_dir()) for i in inputs]
    folders = [p.parent if virtual else p for p, virtual in named if virtual or is_url(p) or p.is_dir()]
    names: dict[Path, Path] = {}
    taken: dict[str, Path] = {}
    for source in sources:
        same = [f for f in folders if type(f) is type(source.path) and f != source.path]
        below = [Path(str(source.path.relative_to(f))) for f in same if source.path.is_relative_to(f)]
        name = below[0] if below else Path(source.path.name)
        stem = name.name[: -len(name.suffix)]
        stem = stem.removesuffix(".copc") if source.copc or suffix == COPC_SUFFIX else stem
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
    """Return the parameters as plain values and as dataclass, or ({}, None) for `keep`."""
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
    given = {str(source.path): source for source in known}
    if given and all(str(path) in given for path in paths):
        return [given[str(path)] for path in paths], []
    sources: list[SourceInfo] = []
    unreadable: list[tuple[str, str]] = []
    with ChildPool(_readers(paths, config)) as guards:
        looks: Iterable[Callable[[], SourceInfo]] = (
            (partial(inspect, path, config.salvage) for path in paths)
            if config.in_process
            else guards.each(partial(inspect_in_child, salvage=config.salvage), paths)
        )
        for path, look in zip(paths, looks, strict=True):
            try:
                sources.append(look())
            except InputError as error:
                if config.on_error == "stop" or len(paths) == 1:
                    raise
                unreadable.append((str(path), str(error)))
    if not sources:
        raise InputError(f"none of {len(paths)} inputs can be read; the first error: {unreadable[0][1]}")
    return sources, unreadable


def _readers(paths: Sequence[Path], config: RunConfig) -> int:
    """Return the number of processes that inspect the inputs.

    Each has at least `FILES_OF_A_READER` files, except the last, because starting a process takes time.
    """
    far = sum(is_url(path) for path in paths)
    workers = config.workers or machine.default_workers()
    near = min(workers, math.ceil((len(paths) - far) / FILES_OF_A_READER))
    return max(near, min(FAR_READERS, math.ceil(far / FILES_OF_A_READER)), 1)
