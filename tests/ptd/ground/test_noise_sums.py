"""Density and noise of places: what a survey has alone, whatever lies farther off, in any tiles and order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.ground.noise_sums import AROUND, REACH_M, by_place, merge
from ptd.ground.roughness import REACH_M as SEEN_M
from ptd.ground.roughness import measure, measure_places
from ptd.places import PLACE_M, field, name_of, value_at

MM, EVERYTHING = Scale(), Window.everything()


def partial(
    column: int, row: int, density: float, noise_mm: int, cells: int = 4096
) -> dict[str, Any]:
    """A place full of planar patches of one noise."""
    return {
        "place": [column, row], "points": round(16 * density * cells), "cells": cells, "full": cells,
        "patches": [noise_mm, cells], "quarters": [noise_mm, 4 * cells],
    }  # fmt: skip


def field_of(seed: int, sigma: float, density: float, west: float, side: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x, y = side * rng.random((2, round(side * side * density)))
    return np.rint(1000 * np.stack([x + west, y, rng.normal(0, sigma, x.size)])).astype(
        np.int32
    )


def test_places_add_up_to_the_run() -> None:
    xyz = field_of(1, 0.05, 6.0, 200.0, 110.0)
    places = measure_places(xyz, EVERYTHING, MM)
    assert [place["place"] for place in places] == [[0, 0], [1, 0]]
    assert merge(places) == merge([measure(xyz, EVERYTHING, EVERYTHING, MM)])


def test_a_survey_in_one_place_has_the_figures_of_the_run() -> None:
    xyz = field_of(2, 0.05, 6.0, 20.0, 60.0)
    run, found = (
        merge([measure(xyz, EVERYTHING, EVERYTHING, MM)]),
        by_place(measure_places(xyz, EVERYTHING, MM)),
    )
    assert len(found) == (2 * AROUND + 1) ** 2
    for of_place in found.values():
        assert of_place.density_m2 == pytest.approx(run.density_m2, rel=1e-3)
        assert (of_place.sigma_m, of_place.smoothest_m) == (run.sigma_m, run.smoothest_m)


def test_tiles_and_order_change_nothing() -> None:
    xyz = np.concatenate(
        [field_of(3, 0.03, 4.0, 180.0, 120.0), field_of(4, 0.2, 9.0, 300.0, 120.0)], axis=1
    )
    whole = by_place(measure_places(xyz, EVERYTHING, MM))
    assert len({figures.sigma_m for figures in whole.values()}) > 1
    partials, step, reach = [], 61_300, round(1000 * SEEN_M)
    for west in range(0, 500_000, step):
        for south in range(0, 140_000, step):
            core = Window(west, south, west + step, south + step)
            seen = Window(
                core.west - reach, core.south - reach, core.east + reach, core.north + reach
            )
            partials += measure_places(xyz[:, seen.contains(xyz[0], xyz[1])][:, ::-1], core, MM)
    assert by_place(partials) == whole
    assert by_place(reversed(partials)) == whole


def test_nothing_beyond_the_reach_has_a_part() -> None:
    """A strip of places, and at the 100th metre of place 0 what the first place beyond the reach changes."""
    strip = [partial(column, 0, 20.0, 40) for column in range(8)]
    beside = [partial(column, 0, 0.5, 200) for column in range(8, 12)]

    def figures(partials: list[dict[str, Any]], x_m: float) -> list[float]:
        found = by_place(partials)
        table = {
            name_of(*p): [f.density_m2, f.sigma_m, f.smoothest_m] for p, f in found.items()
        }
        return [
            value_at(field(table, k, MM, 0.0), round(1000 * x_m), 100_000) for k in range(3)
        ]

    border = 8 * PLACE_M
    for x_m in (border - REACH_M - 0.01, border - REACH_M - 300.0):
        assert figures(strip, x_m) == figures(strip + beside, x_m)
    assert figures(strip, border - 1.0) != figures(strip + beside, border - 1.0)


def test_a_sparse_strip_beside_a_dense_survey_has_a_density_of_its_own() -> None:
    places = [
        partial(column, row, 20.0 if column < 0 else 0.5, 40)
        for column in range(-4, 4)
        for row in range(4)
    ]
    found = by_place(places)
    for column in range(-4, 4):
        expected = 20.0 if column < 0 else 0.5
        assert found[column, 2].density_m2 == pytest.approx(expected, rel=0.15)


def test_a_sliver_has_the_figures_of_what_is_beside_it() -> None:
    """Three cells of 4096, with other points."""
    sliver = {**partial(1, 0, 1.0, 290, cells=3), "patches": [], "quarters": []}
    of_sliver = by_place([partial(0, 0, 8.0, 50), sliver])[1, 0]
    assert of_sliver.density_m2 == pytest.approx(8.0, rel=0.1)
    assert of_sliver.sigma_m == pytest.approx(0.0505)


def test_no_points() -> None:
    assert measure_places(np.zeros((3, 0), np.int32), EVERYTHING, MM) == []
    assert by_place([]) == {}
