"""Decisions of the first run on a store, which later runs keep so that they find its results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

from tiler.core.lattice import COUNTS_PER_UNIT, Cell
from tiler.core.units import length_text
from tiler.core.words import name_in_wkt
from tiler.errors import ConfigError, StoreError
from tiler.inputs import DensityPatch
from tiler.plan.density_map import DensityMap
from tiler.plan.model import Plan
from tiler.plan.sizes import resolution_of
from tiler.plan.validation import validate
from tiler.store import TileStore

FROM_POINTS = "grid-from-points"
"""Name in the store of the decisions of `settled_by_points`."""


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
        resolution = config.resolution or Fraction(known["resolution"])
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
