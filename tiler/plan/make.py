"""Making of the plan from the headers of the inputs and the settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from ptd.matched.evidence import decided_by
from ptd.methods import METHODS, make_params
from ptd.params import to_json
from tiler.config import RunConfig
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.units import in_unit_of_crs
from tiler.core.words import listed
from tiler.errors import ConfigError, InputError
from tiler.inputs import SourceInfo, find_inputs, resolve_common_crs
from tiler.io.locations import is_url
from tiler.io.proj_database import validate_proj_database
from tiler.io.result_folder import CLOUD_SUFFIXES, earlier_statistics
from tiler.plan import advice, machine, sizes
from tiler.plan.area import area_of, part_of
from tiler.plan.disk import sparse_raster_remedy, sparse_raster_warning
from tiler.plan.distant_files import files_beyond_frame, outlying_files
from tiler.plan.doubtful import incomplete_files, warnings_of
from tiler.plan.drawings import with_user_features
from tiler.plan.ept_nodes import EptInputs, validate_distances
from tiler.plan.equivalents import EQUIVALENTS
from tiler.plan.feet import bare_lengths, with_survey_feet
from tiler.plan.halos import default_halo_m, planned_passes
from tiler.plan.inputs import Inputs, filled_sources
from tiler.plan.inspection import InspectedInputs, inspect_all
from tiler.plan.made_by import validate_single_kind
from tiler.plan.memory import fine_cell_m
from tiler.plan.method import KEEP, MethodPlan, expected_passes, known_kind
from tiler.plan.model import Grid, Plan, Resources
from tiler.plan.validation import (
    validate,
    validate_output_paths,
    validate_pixel_count,
    validate_resolution,
    validate_targets,
)
from tiler.store import StoreMeta

TERRAIN_HALO = Fraction(101, 100)
"""Halo of a block of the terrain that usually suffices, as a multiple of `max_edge`."""


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
        Settings cannot work: method, parameters, memory, disk, or the database of PROJ cannot be found.
    InputError
        No input can be read, or a CRS cannot be used.
    """
    validate_proj_database()
    params = _params_of(config)
    notes: list[str] = []
    folder = None if out is None or is_url(out) else Path(out)
    ept = EptInputs(config)
    left_out: list[tuple[str, str]] = []

    def unlisted(text: str, error: InputError) -> None:
        left_out.append((text, str(error)))

    paths = find_inputs(
        inputs,
        out=folder,
        note=notes.append,
        wanted=ept.node_filter,
        listed=ept.record,
        in_process=config.in_process,
        unlisted=None if config.on_error == "stop" else unlisted,
    )
    if out is not None:
        validate_output_paths(config, str(out), paths)
    sources, unreadable = inspect_all(paths, config, known)
    left_out += unreadable
    sources = ept.with_crs(sources, notes)
    crs = resolve_common_crs(sources, config)
    notes += crs.notes
    config = with_survey_feet(config, crs.units)
    notes += bare_lengths(config, crs.units)
    paths_of_notes: dict[str, list[str]] = {}
    for source in sources:
        for text in source.notes:
            paths_of_notes.setdefault(text, []).append(str(source.path))
    notes += [f"{listed(of, 2, 'files')}: {text}" for text, of in paths_of_notes.items()]
    if not filled_sources(sources):
        raise InputError(
            f"{_names(sources)}: no points to make a terrain from; give clouds with points"
        )
    area = area_of(config, crs.wkt, notes)
    inspected = InspectedInputs(
        given=inputs, sources=sources, left_out=left_out, crs=crs, area=area, notes=notes
    )
    metres = float(crs.units.horizontal)
    inspected = inspected.without(
        files_beyond_frame(inspected.filled, area, crs.wkt, metres), config
    )
    plan = _plan_for(inspected, config, params)
    # Otherwise a pixel of impossible size could be reported as a large raster.
    validate_resolution(plan)
    validate_pixel_count(plan, folder)
    while remedy := sparse_raster_remedy(plan, folder):
        inspected = inspected.without(
            outlying_files(plan.inputs.filled, crs.wkt, metres, remedy), config
        )
        plan = _plan_for(inspected, config, params)
    validate_distances(plan, inputs)
    plan = with_user_features(plan)

    def replan(**values: Any) -> Plan:
        other = _plan_for(inspected, config.updated(**values), params)
        drawn = plan.inputs
        features = replace(
            other.inputs, edits=drawn.edits, lines=drawn.lines, waters=drawn.waters
        )
        return replace(other, inputs=features)

    validate(plan, folder, replan)
    if out is not None:
        validate_targets(plan, str(out), paths)
    return plan


def _plan_for(inspected: InspectedInputs, config: RunConfig, params: Any) -> Plan:
    """Return the plan for the inspected files. Memory, disk and sizes are validated later."""
    units = inspected.crs.units
    inputs = inspected.planned(CLOUD_SUFFIXES[config.classified])
    of_crs = inspected.crs.note_at(*sizes.middle(inputs.extent))
    notes = [*of_crs, *inspected.notes, *inspected.covered[1]]
    resources = _resources(config, notes)
    frame = CoordFrame(units, sizes.origin_of(inputs.extent), inspected.crs.wkt)
    meta = _store_meta(inputs, frame, config, resources.memory, params)
    method = _method_plan(inputs, meta, resources, config, params, notes)
    resolution = sizes.resolution_of(
        config, inputs.density, method.kind, units.horizontal, notes
    )
    plan = Plan(
        config=config,
        inputs=inputs,
        grid=Grid(meta=meta, resolution=resolution, halo_m=config.max_edge * TERRAIN_HALO),
        method=method,
        resources=resources,
        notes=tuple(notes),
        warnings=(),
    )
    if method.statistics is None and method.depends_on_kind:
        validate_single_kind(inputs.filled, config)
    finding, halo_m = decided_by(inputs.evidence), default_halo_m(params)
    advised = advice.preflight_warnings(
        config, finding, inputs.density, halo_m, units.horizontal
    )
    plan = part_of(replace(plan, warnings=(*warnings_of(plan), *advised)))
    text = sparse_raster_warning(plan)
    warnings = [*incomplete_files(plan), *plan.warnings, *filter(None, [text])]
    return replace(
        plan,
        notes=tuple(in_unit_of_crs(text, units) for text in plan.notes),
        warnings=tuple(in_unit_of_crs(text, units) for text in warnings),
    )


def _resources(config: RunConfig, notes: list[str]) -> Resources:
    workers = config.workers or machine.default_workers()
    if config.workers is None and workers < machine.cores():
        mib = machine.memory_bytes() >> 20
        notes.append(
            f"decided: {workers} workers for {machine.cores()} cores, because the memory is {mib:,} MiB (--workers)"
        )
    return Resources(memory=config.memory or machine.fair_share(workers), workers=workers)


def _store_meta(
    inputs: Inputs, frame: CoordFrame, config: RunConfig, memory: int, params: Any
) -> StoreMeta:
    """Return the properties of a new store. Raise ConfigError if the method needs colours and no input has them."""
    filled = inputs.filled
    bucket = sizes.bucket_m(inputs.density, inputs.density_map, memory)
    if inputs.area is not None and any(is_url(s.path) and s.octree is not None for s in filled):
        bucket = min(bucket, sizes.FETCHED_BUCKET_M)
    colours = params is not None and "rgb" in METHODS[config.method].needs
    has_rgb = colours and any(s.has_rgb for s in filled)
    if colours and not has_rgb:
        raise ConfigError(
            f"--method {config.method}: needs colours (RGB), but no input has them; use another method"
        )
    return StoreMeta(
        frame=frame,
        bucket=Lattice(frame.counts(Fraction(bucket))),
        fine=Lattice(frame.counts(fine_cell_m(_candidate_cell_m(params), Fraction(bucket)))),
        has_rgb=has_rgb,
    )


def _method_plan(
    inputs: Inputs,
    meta: StoreMeta,
    resources: Resources,
    config: RunConfig,
    params: Any,
    notes: list[str],
) -> MethodPlan:
    """Return the method with the kind of the clouds, as far as it is known, and its passes and tiles."""
    parameters = {} if params is None else to_json(params)
    statistics = None
    if config.statistics is not None:
        statistics = earlier_statistics(Path(config.statistics), config.method, parameters)
    kind = known_kind(config, statistics, None if params is None else inputs.evidence)
    passes = () if params is None else planned_passes(params, config, kind, notes)
    memory, density, cell_m = resources.memory, inputs.density, _candidate_cell_m(params)
    expected = expected_passes(passes, kind, density)
    return MethodPlan(
        parameters=parameters,
        passes=passes,
        candidate_cell_m=cell_m,
        kind=kind,
        statistics=statistics,
        tile=config.tile_size or sizes.tile_m(memory, density, cell_m, expected, meta),
        tile_memory=memory,
        tile_workers=0 if config.tile_size else resources.workers,
    )


def _candidate_cell_m(params: Any) -> float:
    """Return the side of the method's thinning cells in metres, 0 if it has none."""
    return 0.0 if params is None else float(params.candidate_cell_m)


def _params_of(config: RunConfig) -> Any:
    """Return the parameters of the method, or None for `keep`."""
    if config.method == KEEP:
        if config.parameters:
            raise ConfigError(
                f"--set {config.parameters[0][0]}: method keep has no parameters; leave it out"
            )
        if not config.ground_classes:
            raise ConfigError(
                "--ground-classes none: method keep needs the classes of the ground; give at least one, such as 2"
            )
        return None
    if config.method not in METHODS:
        known = EQUIVALENTS.get(config.method.lower(), "does not exist; ")
        raise ConfigError(
            f"--method {config.method}: {known}use one of {', '.join([*METHODS, KEEP])}"
        )
    try:
        return make_params(config.method, dict(config.parameters))
    except ValueError as error:
        raise ConfigError(f"--set {error} (method {config.method})") from error


def _names(sources: Sequence[SourceInfo]) -> str:
    return listed([str(source.path) for source in sources], 1, "files")
