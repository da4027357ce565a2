"""The plan: everything that can be decided or refused before the first point is read."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from ptd.methods import METHODS, make_params
from ptd.params import to_json
from ptd.passes import Pass
from tiler.config import RunConfig
from tiler.core.frame import COUNTS_PER_UNIT, CoordFrame
from tiler.core.lattice import Bounds, Lattice
from tiler.core.units import unit_label
from tiler.errors import ConfigError, InputError
from tiler.ingest import SourceInfo, agree, bounds_in_counts, find_inputs, inspect, inspect_guarded
from tiler.report import earlier_statistics
from tiler.schedule import Guard
from tiler.store import StoreMeta

KEEP = "keep"
"""The method that trusts the classes of the input."""

FINE_CELL_M = Fraction(1, 2)
BUCKET_POINTS = 100_000
BUCKETS_M = (8, 16, 32, 64, 128)
TILE_M = 512
GRID_BLOCK = 512
MAX_HALO_FACTOR = 4
BASE_BYTES = 260 << 20
"""Of a worker before the first point: the interpreter and the libraries."""
READ_BYTES = 60
"""Of a candidate that a window reads: columns, sorting."""
VERTEX_BYTES = 200
"""Of a candidate that may become a vertex: its columns while it is tested, its share of the TIN."""
BUCKET_POINT_BYTES = 200
"""Of a point while its bucket is assembled or labelled."""
PIECE_POINTS = 1_000_000
GROUND_BYTES = 200
"""Of a ground point in a block's window: coordinates and the TIN."""
MAX_GROUND = 4_000_000
"""Points that the window of a part of a block may hold; denser clouds give one a quarter pixel, everywhere."""
PART = 128
"""Pixels a side of the parts into which blocks are divided where points are many."""
STORED_BYTES = 24
"""Of a point on disk in the store, spool included, compressed; measured on a city."""
MAX_DENOMINATOR = 511
"""Of a pixel's side in counts, so that gridding is exact in int64."""
WIDEST_RELIEF_M = 9000
SECONDS_PER_MILLION = 3.5
"""CPU seconds a million points from LAZ to COG and LAZ; measured on a city, other machines differ."""


@dataclass(frozen=True)
class PlannedPass:
    """What a pass of the method sees of a tile's surroundings.

    Attributes
    ----------
    name : str
    halo_m : float
    fixed : bool
        The halo is the pass's proven reach and never widened (`ptd.passes.Pass.reach_m`).
    every_point : bool
        It reads all points, not one candidate a cell.
    """

    name: str
    halo_m: float
    fixed: bool
    every_point: bool


@dataclass(frozen=True)
class Plan:
    """What a run will do; lengths in metres, sizes in bytes.

    Attributes
    ----------
    sources : tuple of SourceInfo
        That can be read, in the order of their names; with `unreadable` all that were named.
    unreadable : tuple of (str, str)
        Path and reason of each file that is left out.
    names : dict of Path to Path
        Of each source's classified file, below OUT/classified.
    statistics : dict or None
        State after each pass, by its name, of the earlier run that ``--statistics`` names.
    """

    config: RunConfig
    sources: tuple[SourceInfo, ...]
    unreadable: tuple[tuple[str, str], ...]
    meta: StoreMeta
    limits: Bounds | None
    parameters: dict[str, Any]
    resolution: Fraction
    tile: Fraction
    passes: tuple[PlannedPass, ...]
    memory: int
    workers: int
    candidate_cell_m: float
    points: int
    area_m2: float
    extent: Bounds
    names: dict[Path, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())
    statistics: dict[str, Any] | None = None

    @property
    def density(self) -> float:
        """Points per square metre of the sources' bounds."""
        return self.points / self.area_m2 if self.area_m2 else 0.0

    @property
    def grid_halo(self) -> Fraction:
        """Metres around a block with which it seldom needs more: a little more than the limit of a facet's edges."""
        return self.config.max_edge * Fraction(101, 100)

    @property
    def thin_ground(self) -> bool:
        """Only one ground point per quarter pixel makes the surface."""
        return self.density * (PART * float(self.resolution) + 2 * float(self.grid_halo)) ** 2 > MAX_GROUND

    @property
    def block_points(self) -> int:
        """Points in the window of a block above which it is done in parts."""
        return max((self.memory - BASE_BYTES) // GROUND_BYTES, MAX_GROUND // 8)

    @property
    def halo_m(self) -> float:
        """The widest halo that a pass starts with, metres."""
        return max((step.halo_m for step in self.passes), default=0.0)

    @property
    def overlap(self) -> float:
        """Padded area over core area of a filter tile, in the pass that sees most."""
        return float(((self.tile + 2 * Fraction(self.halo_m)) / self.tile) ** 2)

    @property
    def tiles(self) -> int:
        """Filter tiles, if the sources' bounds were filled."""
        return max(math.ceil(self.area_m2 / float(self.tile) ** 2), 1)

    def projected_memory(self) -> dict[str, int]:
        """Peak bytes of a worker by stage."""
        bucket = self.density * float(self.meta.bucket.size * self.meta.frame.metres_xy) ** 2
        return {
            "ingest": int(BASE_BYTES + max(PIECE_POINTS * 160, bucket * BUCKET_POINT_BYTES * 4)),
            "filter": max((self._filter_bytes(s, self.widest_halo_m(s)) for s in self.passes), default=0),
            "grid": BASE_BYTES + min(self.points, self.block_points) * GROUND_BYTES,
        }

    def _filter_bytes(self, step: PlannedPass, halo_m: float) -> int:
        """Peak bytes of a worker that does a tile of a pass with that halo."""
        window = min((float(self.tile) + 2 * halo_m) ** 2, self.area_m2)
        read = window_bytes(self.density, self.candidate_cell_m, step) * window
        bucket = self.density * float(self.meta.bucket.size * self.meta.frame.metres_xy) ** 2
        return int(BASE_BYTES + read + bucket * BUCKET_POINT_BYTES)

    def widest_halo_m(self, step: PlannedPass) -> float:
        """Metres of halo that a tile with marks may take: doubled and doubled again while the memory allows."""
        halo = step.halo_m
        if step.fixed:
            return halo
        while 0 < halo < MAX_HALO_FACTOR * step.halo_m and self._filter_bytes(step, 2 * halo) <= self.memory:
            halo *= 2
        return halo

    def projected_disk(self) -> int:
        """Bytes of store, rasters (three copies while the COG is made) and classified clouds."""
        metres = float(self.meta.frame.metres_xy)
        pixels = self.extent.area() * metres**2 / float(self.resolution) ** 2
        rasters = len({"dtm", *self.config.products})
        return int(
            self.points * STORED_BYTES + 3 * 4 * pixels * rasters + 1.2 * sum(s.size for s in self.sources)
        )

    def to_json(self) -> dict[str, Any]:
        """Everything as plain values."""
        frame = self.meta.frame
        return {
            "inputs": len(self.sources), "unreadable": [list(u) for u in self.unreadable], "points": self.points,
            "area_m2": self.area_m2, "density_per_m2": self.density, "crs": frame.crs_wkt,
            "units": {"horizontal": unit_label(frame.units.horizontal), "vertical": unit_label(frame.units.vertical)},
            "method": self.config.method, "parameters": self.parameters, "passes": len(self.passes),
            "halos_m": {step.name: step.halo_m for step in self.passes},
            "resolution_m": float(self.resolution), "tile_m": float(self.tile),
            "bucket_m": float(self.meta.bucket.size * frame.metres_xy), "halo_m": self.halo_m,
            "tiles": self.tiles, "overlap_work": self.overlap, "workers": self.workers, "memory_bytes": self.memory,
            "projected_memory_bytes": self.projected_memory(), "projected_disk_bytes": self.projected_disk(),
            "projected_seconds": self.points / 1e6 * SECONDS_PER_MILLION / self.workers,
            "notes": list(self.notes), "warnings": list(self.warnings),
        }  # fmt: skip

    def lines(self) -> list[str]:
        """The plan as people read it."""
        frame, memory = self.meta.frame, self.projected_memory()
        worst = max(memory, key=lambda k: memory[k])
        metres = float(frame.metres_xy)
        west, south = self.extent.x0 / COUNTS_PER_UNIT, self.extent.y0 / COUNTS_PER_UNIT
        wide, high = (self.extent.x1 - self.extent.x0) * metres, (self.extent.y1 - self.extent.y0) * metres
        return [
            f"inputs      {len(self.sources)} files, {self.points:,} points, {self.density:.3g} per m2",
            f"extent      {wide:,.0f} x {high:,.0f} m from ({west:,.1f}, {south:,.1f})",
            f"CRS         {crs_name(frame.crs_wkt)}; x, y in {unit_label(frame.units.horizontal)}, "
            f"z in {unit_label(frame.units.vertical)}",
            f"method      {self.config.method}" + _passes_in_words(self.passes),
            f"DTM         {float(self.resolution):g} m pixels, "
            f"nodata beyond facets of {float(self.config.max_edge):g} m",
            f"products    {', '.join(self.config.products)}",
            f"tiles       about {self.tiles} of {float(self.tile):g} m with {self.halo_m:g} m of halo, "
            f"overlap work {self.overlap:.2f}",
            f"memory      {memory[worst] / 2**20:,.0f} MiB a worker at most ({worst}), "
            f"{self.memory / 2**20:,.0f} MiB allowed, {self.workers} workers",
            f"disk        about {self.projected_disk() / 1e9:.2f} GB",
            f"time        about {self.points / 1e6 * SECONDS_PER_MILLION / self.workers:,.0f} s, plus start-up",
            *(f"note        {text}" for text in self.notes),
            *(f"warning     {text}" for text in self.warnings),
            *(f"left out    {path}: {reason}" for path, reason in self.unreadable),
        ]  # fmt: skip


def _passes_in_words(passes: tuple[PlannedPass, ...]) -> str:
    """Number of passes, and what each sees around a tile where there are several."""
    if len(passes) < 2:
        return ", 1 pass" if passes else ""
    return f", {len(passes)} passes, halo: " + ", ".join(f"{step.name} {step.halo_m:g} m" for step in passes)


def crs_name(wkt: str | None) -> str:
    """The name of a CRS for people."""
    if wkt is None:
        return "unknown"
    return wkt.split('"', 2)[1] if '"' in wkt else wkt


def make_plan(inputs: Sequence[str], config: RunConfig, out: Path | None = None) -> Plan:
    """Read the headers, settle CRS, units, method, sizes, and refuse what cannot work.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs.
    config : RunConfig
    out : Path, optional
        The run's folder: not searched for inputs, and its disk is checked.

    Raises
    ------
    ConfigError
        Settings that cannot work: method, parameters, memory, disk.
    InputError
        No readable input, or a CRS that cannot be used.
    """
    parameters, defaults = _method(config)
    notes: list[str] = []
    paths = find_inputs(inputs, () if out is None else (out,), notes.append)
    sources, unreadable = _inspect_all(paths, config)
    agreement = agree(sources, config)
    notes += agreement.notes
    filled = [s for s in sources if s.points and s.bounds is not None]
    notes += [f"{s.path}: {text}" for s in sources for text in s.notes]
    if not filled:
        raise InputError(f"{_names(sources)}: hold no point; nothing to make a terrain of")
    limits = None if config.bounds is None else bounds_in_counts(config.bounds)
    extent, area = _extent(filled, float(agreement.units.horizontal))
    frame = CoordFrame(agreement.units, _origin(extent), agreement.wkt)
    points = sum(s.points for s in filled)
    density = points / area
    meta = StoreMeta(
        frame=frame, bucket=Lattice(frame.counts(Fraction(_bucket_m(density)))),
        fine=Lattice(frame.counts(FINE_CELL_M)), has_rgb=any(s.has_rgb for s in filled),
    )  # fmt: skip
    memory = config.memory or min(1 << 30, psutil.virtual_memory().total // (4 * (psutil.cpu_count() or 1)))
    if defaults and "rgb" in METHODS[config.method].needs and not meta.has_rgb:
        raise ConfigError(
            f"--method {config.method}: needs colours (RGB), no input has any; use another method"
        )
    cell = defaults.candidate_cell_m if defaults else 0.0
    passes = _planned_passes(defaults, config, notes) if defaults else ()
    tile = config.tile_size or _tile(memory, density, cell, passes, meta)
    warnings = _warnings(filled, agreement.units, tile, max((step.halo_m for step in passes), default=0.0))
    plan = Plan(
        config, tuple(sources), tuple(unreadable), meta, limits, parameters,
        _resolution(config, density, notes), tile, passes, memory, config.workers or psutil.cpu_count() or 1,
        cell, points, area,
        limits or extent, output_names(inputs, sources), tuple(notes), tuple(warnings),
        None if config.statistics is None else earlier_statistics(Path(config.statistics), config.method, parameters),
    )  # fmt: skip
    refuse(plan, out)
    return plan


def output_names(inputs: Sequence[str], sources: Iterable[SourceInfo]) -> dict[Path, Path]:
    """Path of each classified file below OUT/classified; ConfigError where two would be one."""
    folders = [Path(i) for i in inputs if Path(i).is_dir()]
    names: dict[Path, Path] = {}
    taken: dict[str, Path] = {}
    for source in sources:
        below = [source.path.relative_to(f) for f in folders if source.path.is_relative_to(f)]
        name = below[0] if below else Path(source.path.name)
        stem = name.name[: -len(name.suffix)]
        stem = stem.removesuffix(".copc") if source.copc else stem
        name = name.with_name(f"{stem}.laz")
        if str(name).lower() in taken:
            raise ConfigError(
                f"{source.path} and {taken[str(name).lower()]} would both become classified/{name}; "
                "rename one, or run on a folder that holds both in different places"
            )
        taken[str(name).lower()] = source.path
        names[source.path] = name
    return names


def _method(config: RunConfig) -> tuple[dict[str, Any], Any]:
    """Parameters as plain values, and their dataclass; ({}, None) for `keep`."""
    if config.method == KEEP:
        if config.parameters:
            raise ConfigError(f"--set {config.parameters[0][0]}: method keep has no parameters")
        return {}, None
    if config.method not in METHODS:
        raise ConfigError(f"--method {config.method}: there is {', '.join([*METHODS, KEEP])}")
    try:
        params = make_params(config.method, dict(config.parameters))
    except ValueError as error:
        raise ConfigError(f"--set {error} (method {config.method})") from error
    return to_json(params), params


def _names(sources: Sequence[SourceInfo]) -> str:
    return f"{sources[0].path}" + (f" and {len(sources) - 1} more files" if len(sources) > 1 else "")


def _inspect_all(paths: Sequence[Path], config: RunConfig) -> tuple[list[SourceInfo], list[tuple[str, str]]]:
    sources: list[SourceInfo] = []
    unreadable: list[tuple[str, str]] = []
    with Guard() as guard:
        look = inspect if config.in_process else partial(inspect_guarded, guard)
        for path in paths:
            try:
                sources.append(look(path, config.salvage))
            except InputError as error:
                if config.on_error == "stop" or len(paths) == 1:
                    raise
                unreadable.append((str(path), str(error)))
    if not sources:
        raise InputError(f"none of {len(paths)} inputs can be read; the first: {unreadable[0][1]}")
    return sources, unreadable


def _extent(sources: Sequence[SourceInfo], metres: float) -> tuple[Bounds, float]:
    """Union of the sources' bounds in absolute counts, and the area that they cover in m2 (overlaps count twice)."""
    area = 0.0
    union: Bounds | None = None
    for source in sources:
        assert source.bounds is not None  # the caller's choice
        x0, y0, _, x1, y1, _ = source.bounds
        area += max(x1 - x0, 1.0) * max(y1 - y0, 1.0) * metres**2
        low, high = (
            (math.floor(v * COUNTS_PER_UNIT) for v in (x0, y0)),
            (math.ceil(v * COUNTS_PER_UNIT) for v in (x1, y1)),
        )
        bounds = Bounds(*low, *(v + 1 for v in high))
        union = bounds if union is None else union.union(bounds)
    assert union is not None  # at least one source
    return union, area


def _origin(extent: Bounds) -> tuple[int, int]:
    """The middle of the extent, on a round number: int32 counts then reach equally far to all sides."""
    step = 1000 * COUNTS_PER_UNIT
    return (extent.x0 + extent.x1) // 2 // step * step, (extent.y0 + extent.y1) // 2 // step * step


def _bucket_m(density: float) -> int:
    """Side of a bucket in metres that holds about `BUCKET_POINTS`."""
    side = math.sqrt(BUCKET_POINTS / density)
    return min(BUCKETS_M, key=lambda b: abs(math.log(b / side)))


def candidate_density(density: float, cell_m: float) -> float:
    """Candidates per square metre that a window reads, for a method that wants one per cell of ``cell_m``."""
    nested = cell_m > 0 and (Fraction(repr(float(cell_m))) / FINE_CELL_M).denominator == 1
    return min(density, float(1 / FINE_CELL_M**2)) if nested else density


def candidate_bytes(cell_m: float) -> float:
    """Bytes of memory for each of them."""
    share = min(float(FINE_CELL_M) ** 2 / cell_m**2, 1.0) if cell_m > 0 else 1.0
    return READ_BYTES + VERTEX_BYTES * share


def window_bytes(density: float, cell_m: float, step: PlannedPass) -> float:
    """Bytes of memory for each square metre of a pass's window."""
    if not step.every_point:
        return candidate_density(density, cell_m) * candidate_bytes(cell_m)
    return density * READ_BYTES + min(density, 1 / cell_m**2 if cell_m else math.inf) * VERTEX_BYTES


def _planned_passes(params: Any, config: RunConfig, notes: list[str]) -> tuple[PlannedPass, ...]:
    """The passes of a method with the halo that each starts with."""

    def halo(step: Pass) -> float:
        if step.reach_m is not None:
            return step.reach_m
        if config.halo is not None:
            return float(config.halo)
        return float(params.halo_m if step.halo_m is None else step.halo_m)

    fixed = [step for step in params.passes if step.reach_m is not None]
    if config.halo is not None and fixed:
        notes.append(
            "--halo is for passes whose reach is not known beforehand; "
            + ", ".join(f"{step.name} sees {step.reach_m:g} m" for step in fixed)
            + ", as far as they reach"
        )
    return tuple(PlannedPass(s.name, halo(s), s.reach_m is not None, s.every_point) for s in params.passes)


def _tile(
    memory: int, density: float, cell_m: float, passes: Iterable[PlannedPass], meta: StoreMeta
) -> Fraction:
    """Largest tile, at most `TILE_M`, whose windows use three quarters of the memory left after start-up."""
    budget = max(memory - BASE_BYTES, memory // 4) * 3 / 4
    sides = [math.sqrt(budget / window_bytes(density, cell_m, step)) - 2 * step.halo_m for step in passes]
    side = min(sides, default=float(TILE_M))
    bucket = meta.bucket.size * meta.frame.metres_xy
    return max(min(Fraction(TILE_M), Fraction(max(side, 0.0))) // bucket, 1) * bucket


def _resolution(config: RunConfig, density: float, notes: list[str]) -> Fraction:
    """1 m, or the mean spacing of the points where that is coarser."""
    if config.resolution is not None:
        return config.resolution
    spacing = 1 / math.sqrt(density)
    if spacing <= 1.05:
        return Fraction(1)
    resolution = Fraction(math.ceil(2 * spacing), 2)
    notes.append(
        f"resolution {float(resolution):g} m: the points are {spacing:.2g} m apart; --resolution overrides"
    )
    return resolution


def _warnings(sources: Sequence[SourceInfo], units: Any, tile: Fraction, halo: float) -> list[str]:
    found = []
    z = [s.bounds for s in sources if s.bounds is not None]
    relief = (max(b[5] for b in z) - min(b[2] for b in z)) * float(units.vertical)
    if relief > WIDEST_RELIEF_M:
        found.append(
            f"heights span {relief:,.0f} m, more than any terrain: noise far from the ground, "
            "or z is in another unit; --units h,v"
        )
    for source in sources:
        assert source.bounds is not None  # the caller's choice
        x0, y0, z0, x1, y1, z1 = source.bounds
        side = max(min(x1 - x0, y1 - y0), 1.0) * float(units.horizontal)
        rise = (z1 - z0) * float(units.vertical)
        if side > 50 and rise > 2 * side:
            found.append(
                f"{source.path}: rises {rise:,.0f} m over {side:,.0f} m: noise, or z is in another unit; --units h,v"
            )
    overlap = float(((tile + 2 * Fraction(halo)) / tile) ** 2)
    if overlap > 2:
        found.append(
            f"tiles of {float(tile):g} m with {halo:g} m of halo do {overlap:.1f} times the work; "
            f"use --tile-size {4 * halo:g} or more --memory"
        )
    return found


def refuse(plan: Plan, out: Path | None) -> None:
    """Raise ConfigError for settings that would fail on the way: memory, disk, resolution, bounds."""
    memory = plan.projected_memory()
    worst = max(memory, key=lambda k: memory[k])
    if memory[worst] > plan.memory:
        smaller = float(plan.meta.bucket.size * plan.meta.frame.metres_xy)
        raise ConfigError(
            f"{worst} needs {memory[worst] / 2**20:,.0f} MiB a worker, {plan.memory / 2**20:,.0f} MiB are allowed; "
            f"use --memory {memory[worst] // 2**20 + 1}MiB"
            + (f" or --tile-size {smaller:g}" if worst == "filter" else "")
        )
    pixel = plan.meta.frame.counts(plan.resolution)
    if pixel.denominator > MAX_DENOMINATOR:
        raise ConfigError(
            f"--resolution {float(plan.resolution):g} m: {float(pixel) / COUNTS_PER_UNIT:.9g} CRS units "
            "is too odd a fraction; give it in the unit of the CRS"
        )
    sheets = plan.config.sheets
    if sheets is not None and (sheets / plan.resolution).denominator != 1:
        raise ConfigError(
            f"--sheets {float(sheets):g} m: no whole number of pixels of {float(plan.resolution):g} m; "
            f"use --sheets {float(max(round(sheets / plan.resolution), 1) * plan.resolution):g} or another --resolution"
        )
    if plan.extent.empty:
        raise ConfigError("--bounds: holds no place")
    existing = None if out is None else next(p for p in (out, *out.resolve().parents) if p.exists())
    if existing is not None and not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigError(f"-o {out}: {existing} cannot be written; name a folder on a disk that can")
    if existing is not None and plan.config.store is None:
        free = shutil.disk_usage(existing).free
        if plan.projected_disk() > free:
            raise ConfigError(
                f"{out}: needs about {plan.projected_disk() / 1e9:.1f} GB, {free / 1e9:.1f} GB are free; "
                "free some or use --store on another disk"
            )
