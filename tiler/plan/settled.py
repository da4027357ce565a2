"""Decisions of the first run on a store, which later runs keep so that they find its results."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

from tiler.core.words import name_in_wkt
from tiler.errors import ConfigError, StoreError
from tiler.plan.model import Plan
from tiler.plan.validation import validate
from tiler.store import TileStore


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
    config, known = plan.config, store.settled
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

    def changed(memory: int, tile_size: Fraction | None = None, **_: Any) -> Plan:
        """Return the plan with more memory or another tile size. All other values are fixed."""
        method = plan.method
        if tile_size is not None and tile_size != method.tile:
            method = replace(method, tile=tile_size, tile_memory=memory, tile_workers=0)
        return replace(plan, method=method, resources=replace(plan.resources, memory=memory))

    validate(plan, None, changed)
    return plan


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
