"""Making of the plan from the headers and the settings, and with the decisions that a store keeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from ptd.matched.evidence import decided_by
from ptd.methods import METHODS
from ptd.params import to_json
from tiler.config import RunConfig
from tiler.core.lattice import COUNTS_PER_UNIT, Cell, CoordFrame, Lattice
from tiler.core.units import (
    FOOT,
    METRE,
    US_SURVEY_FOOT,
    BareLength,
    FeetLength,
    Sides,
    Units,
    in_unit_of_crs,
    length_text,
    number_text,
    short_unit,
)
from tiler.core.words import listed, name_in_wkt
from tiler.errors import ConfigError, InputError, StoreError
from tiler.inputs import DensityPatch, SourceInfo, find_inputs, resolve_common_crs
from tiler.io.locations import is_url
from tiler.io.proj_database import validate_proj_database
from tiler.io.result_folder import CLOUD_SUFFIXES, earlier_statistics
from tiler.plan import sizes
from tiler.plan.area import EptInputs, area_of, part_of, validate_distances
from tiler.plan.drawings import with_user_features
from tiler.plan.drawn_sheets import with_drawn_sheets
from tiler.plan.estimates import sparse_raster_remedy
from tiler.plan.inspection import (
    InspectedInputs,
    files_beyond_frame,
    inspect_all,
    outlying_files,
    validate_single_kind,
)
from tiler.plan.memory import cores, default_workers, fair_share, memory_bytes
from tiler.plan.method import (
    MethodPlan,
    default_halo_m,
    expected_passes,
    fine_cell_m,
    known_kind,
    params_of,
    planned_passes,
)
from tiler.plan.model import Grid, Inputs, Plan, Resources, filled_sources
from tiler.plan.sizes import DensityMap, resolution_of
from tiler.plan.surveys import Survey, surveys_of, visible_share
from tiler.plan.validation import (
    validate,
    validate_output_paths,
    validate_pixel_count,
    validate_resolution,
    validate_targets,
)
from tiler.plan.warnings import (
    incomplete_files,
    preflight_warnings,
    sparse_raster_warning,
    warnings_of,
)
from tiler.store import StoreMeta, TileStore

VERTICAL_SETTINGS = ("contour_interval", "sigma", "spike")
"""Settings that are vertical lengths."""

TERRAIN_HALO = Fraction(101, 100)
"""Halo of a block of the terrain that usually suffices, as a multiple of `max_edge`."""

FROM_POINTS = "grid-from-points"
"""Name in the store of the decisions of `settled_by_points`."""


def make_plan(
    inputs: Sequence[str],
    config: RunConfig,
    out: str | Path | None = None,
    known: Sequence[SourceInfo] = (),
    finest: Fraction | None = None,
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
    finest : Fraction, optional
        Side of a pixel in metres of the run with the finest resolution, if this is a coarser one of the same survey.

    Raises
    ------
    ConfigError
        Settings cannot work: method, parameters, memory, disk, or the database of PROJ cannot be found.
    InputError
        No input can be read, or a CRS cannot be used.
    """
    validate_proj_database()
    params = params_of(config)
    notes: list[str] = []
    if isinstance(config.resolution, tuple):
        notes.append(f"only the finest of {len(config.resolution)} resolutions is planned here")
        config = config.updated(resolution=config.pixel)
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
        names = listed([str(source.path) for source in sources], 1, "files")
        raise InputError(f"{names}: no points to make a terrain from; give clouds with points")
    area = area_of(config, crs.wkt, notes)
    inspected = InspectedInputs(
        given=inputs, sources=sources, left_out=left_out, crs=crs, area=area, notes=notes
    )
    metres = float(crs.units.horizontal)
    inspected = inspected.without(
        files_beyond_frame(inspected.filled, area, crs.wkt, metres), config
    )
    if finest is not None:
        notes.append(
            f"the terrain is the surface of the run with pixels of {length_text(finest, crs.units.horizontal)}"
        )

    surveys, survey_notes, survey_warnings = surveys_of(config, paths, sources)

    def planned(inspected: InspectedInputs, config: RunConfig) -> Plan:
        plan = _plan_for(inspected, config, params, surveys)
        return replace(plan, grid=replace(plan.grid, finest=finest))

    plan = planned(inspected, config)
    # Otherwise a pixel of impossible size could be reported as a large raster.
    validate_resolution(plan)
    validate_pixel_count(plan, folder)
    while remedy := sparse_raster_remedy(plan, folder):
        inspected = inspected.without(
            outlying_files(plan.inputs.filled, crs.wkt, metres, remedy), config
        )
        plan = planned(inspected, config)
    validate_distances(plan, inputs)
    plan = with_drawn_sheets(with_user_features(plan))
    plan = replace(
        plan,
        inputs=replace(plan.inputs, surveys=surveys),
        notes=(*plan.notes, *survey_notes),
        warnings=(*plan.warnings, *survey_warnings),
    )

    def replan(**values: Any) -> Plan:
        other = planned(inspected, config.updated(**values))
        drawn = plan.inputs
        features = replace(
            other.inputs,
            edits=drawn.edits,
            lines=drawn.lines,
            waters=drawn.waters,
            sheets=drawn.sheets,
            surveys=drawn.surveys,
        )
        return replace(other, inputs=features)

    validate(plan, folder, replan)
    if out is not None:
        validate_targets(plan, str(out), paths)
    return plan


def _plan_for(
    inspected: InspectedInputs, config: RunConfig, params: Any, surveys: Sequence[Survey]
) -> Plan:
    """Return the plan for the inspected files. Memory, disk and sizes are validated later."""
    units = inspected.crs.units
    inputs = inspected.planned(CLOUD_SUFFIXES[config.classified])
    of_crs = inspected.crs.note_at(*sizes.middle(inputs.extent))
    notes = [*of_crs, *inspected.notes, *inspected.covered[1]]
    resources = _resources(config, notes)
    frame = CoordFrame(units, sizes.origin_of(inputs.extent), inspected.crs.wkt)
    meta = _store_meta(inputs, frame, config, resources.memory, params)
    method = _method_plan(inputs, meta, resources, config, params, notes)
    bounds = None if inputs.area is None else inputs.area.bounds
    density = inputs.density * visible_share(surveys, inputs.filled, bounds)
    resolution = sizes.resolution_of(config, density, method.kind, units.horizontal, notes)
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
    advised = preflight_warnings(config, finding, inputs.density, halo_m, units.horizontal)
    plan = part_of(replace(plan, warnings=(*warnings_of(plan), *advised)))
    text = sparse_raster_warning(plan)
    warnings = [*incomplete_files(plan), *plan.warnings, *filter(None, [text])]
    return replace(
        plan,
        notes=tuple(in_unit_of_crs(text, units) for text in plan.notes),
        warnings=tuple(in_unit_of_crs(text, units) for text in warnings),
    )


def _resources(config: RunConfig, notes: list[str]) -> Resources:
    workers = config.workers or default_workers()
    if config.workers is None and workers < cores():
        mib = memory_bytes() >> 20
        notes.append(
            f"decided: {workers} workers for {cores()} cores, because the memory is {mib:,} MiB (--workers)"
        )
    return Resources(memory=config.memory or fair_share(workers), workers=workers)


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


def with_survey_feet(config: RunConfig, units: Units) -> RunConfig:
    """Return the settings, with lengths in ``ft`` read as US survey feet if the CRS uses this foot.

    The US survey foot is 2 millionths longer than the international foot. With pixels of 3
    international feet, a sheet of 1500 units of the CRS would not be a whole number of pixels.
    """
    lengths: dict[str, list[Fraction]] = {}
    for name, value, unit in _lengths(config, units):
        in_feet = isinstance(value, FeetLength) and unit == US_SURVEY_FOOT
        lengths.setdefault(name, []).append(value / FOOT * US_SURVEY_FOOT if in_feet else value)
    return config.updated(
        **{
            name: Sides(*values) if name == "sheets" else values[0]
            for name, values in lengths.items()
        }
    )


def bare_lengths(config: RunConfig, units: Units) -> list[str]:
    """Return a line for each length given without a unit if the CRS is not in metres."""
    texts = []
    for name, value, unit in _lengths(config, units):
        if isinstance(value, BareLength) and unit != METRE and value:
            option = f"--{name.replace('_', '-')}"
            number = f"{float(value):g}"
            in_unit = f"{number_text(float(value / unit))} {short_unit(unit)}"
            remedy = f"; give {number}ft for feet" if unit in (FOOT, US_SURVEY_FOOT) else ""
            texts.append(f"{option} {number} is {number} m = {in_unit}{remedy}")
    return list(dict.fromkeys(texts))


def _lengths(config: RunConfig, units: Units) -> Iterator[tuple[str, Fraction, Fraction]]:
    """Yield the name, the value and the unit in the CRS of each length in the settings."""
    for spec in fields(config):
        value = getattr(config, spec.name)
        if spec.metadata["kind"] not in ("length", "lengths", "sheets") or not isinstance(
            value, Fraction | Sides
        ):
            continue
        unit = units.vertical if spec.name in VERTICAL_SETTINGS else units.horizontal
        for length in value if isinstance(value, Sides) else (value,):
            yield spec.name, length, unit


def settled(plan: Plan) -> dict[str, Any]:
    """Return the decisions of a plan that its new store keeps, in addition to the lattices, as JSON-able values."""
    return {
        "tile": str(plan.method.tile),
        "resolution": str(plan.grid.resolution),
        "memory": plan.resources.memory,
        "thin": plan.thin_ground,
        "workers": plan.method.tile_workers,
    }


def settled_by(plan: Plan, store: TileStore) -> Plan:
    """Return the plan with the frame, buckets, tiles, pixels and thinning of an existing store.

    Tiles and pixels that the user gives take precedence.

    Raises
    ------
    ConfigError
        The store has another CRS or no colours, or the plan does not fit into the memory with the store's tiles.
    StoreError
        The description of the store is damaged.
    """
    _validate_store(plan, store)
    config, known = plan.config, {**store.settled, **(store.get_state(FROM_POINTS) or {})}
    try:
        tile = config.tile_size or Fraction(known["tile"])
        resolution = config.pixel or Fraction(known["resolution"])
        same_tiles = tile == Fraction(known["tile"])
        memory = known["memory"] if same_tiles else plan.resources.memory
        workers = int(known.get("workers", 0)) if same_tiles else plan.method.tile_workers
        thin = known["thin"]
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise StoreError(
            f"{store.url}: its description is damaged ({error}); run again with --overwrite"
        ) from error
    plan = replace(
        plan,
        grid=replace(plan.grid, meta=store.meta, resolution=resolution, thin=thin),
        method=replace(plan.method, tile=tile, tile_memory=memory, tile_workers=workers),
    )
    _validate_settled(plan)
    return plan


def settled_by_points(
    plan: Plan, store: TileStore, measured: Mapping[Cell, int], n_points: int, complete: bool
) -> Plan:
    """Return the plan with the default pixel and the thinning that follow from the points, and keep both in the store.

    The headers, from which the plan decided both, count the points of overlapping files several
    times, and withheld points and noise as well. An earlier decision on the store stays.

    Parameters
    ----------
    plan : Plan
    store : TileStore
    measured : mapping of Cell to int
        Number of points in each bucket that decide (`BucketRecord.n_measured`).
    n_points : int
        Number of all points that were read, near the area of the run if it has one.
    complete : bool
        Whether all buckets are there. Otherwise the next run decides again.

    Raises
    ------
    ConfigError
        The settings do not suit the pixel.
    """
    n_measured = sum(measured.values())
    if store.get_state(FROM_POINTS) is not None or not n_measured:
        return plan
    metres, side = (
        float(plan.frame.units.horizontal),
        float(plan.buckets.size) / COUNTS_PER_UNIT,
    )
    patches = (
        DensityPatch(
            cell.ix * side, cell.iy * side, (cell.ix + 1) * side, (cell.iy + 1) * side, n
        )
        for cell, n in measured.items()
    )
    # The share of the points, not their number, since the plan estimates the points of an area.
    inputs = replace(
        plan.inputs,
        points=round(plan.inputs.points * n_measured / n_points),
        density_map=DensityMap(patches, metres),
    )
    unit = plan.frame.units.horizontal
    resolution = resolution_of(plan.config, inputs.density, plan.method.kind, unit, [])
    notes = plan.notes
    if resolution != plan.grid.resolution:
        others = tuple(text for text in notes if not text.startswith("decided: pixels of"))
        text = (
            f"decided: pixels of {length_text(resolution, unit)}, because only {n_measured:,} of {n_points:,} points "
            "are neither duplicates nor withheld, noise or left out (--resolution)"
        )
        notes = (*others, text)
    decided = replace(plan.grid, resolution=resolution, thin=None)
    thin = replace(plan, inputs=inputs, grid=decided).exceeds_max_ground
    plan = replace(plan, grid=replace(decided, thin=thin), notes=notes)
    _validate_settled(replace(plan, inputs=inputs))
    if complete:
        store.put_state(FROM_POINTS, {"resolution": str(resolution), "thin": thin})
    return plan


def _validate_settled(plan: Plan) -> None:
    """Raise ConfigError if a plan cannot work with what a store decides."""

    def changed(memory: int, tile_size: Fraction | None = None, **_: Any) -> Plan:
        """Return the plan with more memory or another tile size. All other values are fixed."""
        method = plan.method
        if tile_size is not None and tile_size != method.tile:
            method = replace(method, tile=tile_size, tile_memory=memory, tile_workers=0)
        return replace(plan, method=method, resources=replace(plan.resources, memory=memory))

    validate(plan, None, changed)


def _validate_store(plan: Plan, store: TileStore) -> None:
    """Raise ConfigError if a store has another CRS, or if it lacks colours that the method needs."""
    old, new = store.meta, plan.grid.meta
    if (old.frame.crs_wkt, old.frame.units) != (new.frame.crs_wkt, new.frame.units):
        raise ConfigError(
            f"{store.url}: contains points in {name_in_wkt(old.frame.crs_wkt, 'unknown')}, "
            f"the inputs are in {name_in_wkt(new.frame.crs_wkt, 'unknown')}; use --overwrite or another -o"
        )
    if new.has_rgb and not old.has_rgb:
        raise ConfigError(
            f"{store.url}: contains no colours, which --method {plan.config.method} needs; "
            "use --overwrite or another -o"
        )
