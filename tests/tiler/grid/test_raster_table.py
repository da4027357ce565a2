"""The order in which rasters are made follows from what each is made from."""

from __future__ import annotations

import inspect
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest

from tiler.config import RunConfig
from tiler.core.lattice import CoordFrame
from tiler.core.products import PRODUCTS
from tiler.grid.steps import READERS
from tiler.grid.tasks.gridding import Grid
from tiler.grid.tasks.raster_table import raster_table, required_rasters
from tiler.grid.tasks.steps import Step
from tiler.runs.found import final_raster


def plan_of(settings: dict[str, Any]) -> Any:
    """Return a plan with these settings, as far as the table needs one."""
    grid = SimpleNamespace(
        resolution=Fraction(1), surface_pixel=Fraction(1), halo_m=Fraction(10)
    )
    config = RunConfig.from_mapping(settings)
    return SimpleNamespace(config=config, frame=CoordFrame(), grid=grid)


@pytest.mark.parametrize("voids", ["leave", "fill", "mark"])
def test_each_raster_comes_after_its_inputs_and_only_once(voids: str) -> None:
    plan = plan_of({"products": list(PRODUCTS), "voids": voids})
    order = [raster.name for raster in required_rasters(plan)]
    assert order[0] == "dtm"
    assert len(order) == len(set(order))
    for raster in required_rasters(plan):
        assert all(order.index(source) < order.index(raster.name) for source in raster.inputs)
    assert {final_raster(product, plan.config) for product in PRODUCTS} <= set(order)


@pytest.mark.parametrize("canopy", ["void", "fill"])
@pytest.mark.parametrize("water", ["auto", "none"])
def test_steps_read_and_are_given_what_their_functions_take(canopy: str, water: str) -> None:
    plan = plan_of({"products": list(PRODUCTS), "canopy": canopy, "water": water})
    steps = [raster for raster in raster_table(plan).values() if isinstance(raster, Step)]
    assert len(steps) > 15
    for step in steps:
        parameters = inspect.signature(step.work).parameters.values()
        read = {p.name: p for p in parameters if p.kind is not p.KEYWORD_ONLY}
        needed = {name for name, p in read.items() if p.default is p.empty}
        assert needed <= step.reads.keys() <= read.keys(), step.name
        assert step.values.keys() <= {p.name for p in parameters} - read.keys(), step.name


def test_a_row_of_a_product_reads_what_files_have() -> None:
    """`raster:dtm` would be the terrain before voids are filled, and nothing would tell the blocks without a raster."""
    for name, row in PRODUCTS.items():
        kinds = {read.kind for read in row.reads.values()}
        assert kinds <= {"delivered", *READERS} - {"raster"}, name
        assert not kinds or kinds & {"delivered", "points"}, name


def test_nothing_is_made_that_no_product_needs() -> None:
    def names(
        products: list[str], voids: str = "leave", outline: str = "hull", **more: str
    ) -> list[str]:
        settings = {
            "products": products,
            "voids": voids,
            "outline": outline,
            "water": "none",
        } | more
        made = [raster.name for raster in required_rasters(plan_of(settings))]
        # Every run looks for terrain above all returns, and for objects left in it.
        assert (made.pop(), made.pop()) == ("dtm-left", "dtm-above")
        return made

    survey = ["occupancy", "survey-open", "survey"]
    canopy = ["canopy", "canopy-cells", "canopy-terrain", "canopy-below"]
    terrain = ["dtm", *survey, *canopy, "dtm-outlined"]
    assert names(["slope"]) == [*terrain, "slope"]
    search = [
        "water-ground",
        "domain-open",
        "domain",
        "water-areas",
        "water-rims",
        "water-sure",
        "water-planes",
        "water-plane-rims",
        "water-plane-sure",
        "water-crowns",
        "water-cells",
    ]
    with_water = ["dtm", *survey, *search, *canopy, "dtm-outlined", "slope"]
    assert names(["slope"], water="auto") == with_water
    assert names(["slope"], canopy="void") == [
        "dtm",
        *survey,
        "canopy",
        "dtm-outlined",
        "slope",
    ]
    assert names(["ndsm"]) == [*terrain, "dsm", "ndsm"]
    assert names(["mask"]) == [*terrain, "mask"]
    filled = ["dtm", *survey, "dtm-voids", "dtm-filled", *canopy, "dtm-outlined"]
    assert names(["slope"], "fill") == [*filled, "slope"]
    assert names(["dtm"], "fill", "survey") == filled
    assert names(["ndsm"], "fill") == [*filled, "dsm", "dsm-voids", "dsm-filled", "ndsm"]


def test_rasters_of_pixels_hold_the_nodata_value_of_their_product_where_nothing_was_written() -> (
    None
):
    table = raster_table(plan_of({"voids": "fill", "max_edge": "40", "water": "none"}))
    fills = {name: raster.fill for name, raster in table.items()}
    assert fills["dtm"] == fills["dtm-filled"] == fills["dsm"] == fills["slope"] == -9999
    assert fills["distance"] == 40
    for name, product in PRODUCTS.items():
        assert product.nodata in (None, fills[name]), name
    coarse = {name for name, raster in table.items() if raster.grid is Grid.COARSE}
    assert coarse == {"occupancy", "survey-open", "survey", "dtm-voids", "dsm-voids"}
