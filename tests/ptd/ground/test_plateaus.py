"""Surfaces above all that is seen around them, on rasters drawn by hand."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import EMPTY, CellRaster
from ptd.ground.plateaus import ROOF_STEPS_M, Plateaus, on_plateaus, plateaus, remaining_roofs
from tests.scenes.halls import COLUMNS, PLAIN, ROWS, with_hall

SEEN = {"gap": 2, "view": 4, "slope": 0.0, "share": 0.9, "unseen": 0.5}
RULE = Plateaus(step=1500.0, fall=1500.0, widest=12, widest_cut=8, **SEEN)
WAYS = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]


def land(height: int = 0) -> np.ndarray:
    return np.full((30, 30), height, np.int32)


def test_a_roof_is_found_whole() -> None:
    heights = land()
    heights[10:20, 8:15] = 5000
    assert np.array_equal(plateaus(heights, RULE), heights == 5000)


def test_points_of_the_roof_in_cells_of_its_edge_are_on_it_too() -> None:
    """A roof that covers half of the cells along two of its edges."""
    steps = np.arange(250, 30_000, 500, dtype=np.int32)
    x, y = (c.ravel() for c in np.meshgrid(steps, steps))
    roof = (x > 9000) & (x < 16_500) & (y > 9000) & (y < 16_500)
    z = np.where(roof, 5000, 0).astype(np.int32)
    ground = np.ones(z.size, bool)
    ground[::7] = False
    raster = CellRaster(x, y, CellLattice(1000, 1, 0, 0))
    assert np.array_equal(on_plateaus(z, ground, ~ground, raster, RULE), roof & ground)


def test_a_gabled_roof_among_trees_is_found() -> None:
    """Steps of 1 m on the roof, two cells without ground around it."""
    heights = land()
    heights[8:22, 6:20] = EMPTY
    heights[10:20, 8:18] = 5000 + 1000 * np.minimum(np.arange(10), np.arange(10)[::-1])
    assert np.array_equal(plateaus(heights, RULE), (heights > 4000) & (heights != EMPTY))


def test_steps_are_followed_across_gaps() -> None:
    heights = land()
    heights[10:20, 8:18] = 5000
    heights[12, 8:18] = EMPTY
    found = plateaus(heights, RULE)
    assert np.array_equal(found, heights == 5000)
    assert not plateaus(heights, replace(RULE, widest=9)).any()
    heights[12:14, 8:18] = EMPTY
    assert not plateaus(heights, replace(RULE, widest=5)).any()


def test_the_border_of_the_data_may_cut_a_roof_but_not_two_of_its_ends() -> None:
    heights = land()
    heights[:7, 8:16] = 5000
    assert np.array_equal(plateaus(heights, RULE), heights == 5000)
    heights[:9, 8:16] = 5000
    assert not plateaus(heights, RULE).any()  # too wide for one that is cut
    across = land()[:, :10].copy()
    across[12:18] = 5000
    rule = replace(RULE, widest_cut=12)
    assert not plateaus(across, rule).any()
    across[:, 9] = 0
    assert np.array_equal(plateaus(across, rule), across == 5000)
    # Trees at both ends are no border.
    across[12:18, 9] = across[12:18, 0] = EMPTY
    data = np.ones(across.shape, bool)
    assert np.array_equal(plateaus(across, rule, None, data), across == 5000)


def hall_with_annexes() -> np.ndarray:
    """A hall; at its foot a lower roof, a ledge of 3 cells, and beside that one lower still."""
    heights = land()
    heights[10:20, 8:18] = 9000
    heights[10:20, 18:23] = 5000
    heights[20, 9:12] = 6000
    heights[10:20, 23:26] = 2500
    return heights


def test_what_leans_on_a_roof_is_found_after_it() -> None:
    heights = hall_with_annexes()
    removed = np.zeros(heights.shape, bool)
    for lowest in (9000, 5000, 2500):
        roof = plateaus(np.where(removed, EMPTY, heights).astype(np.int32), RULE, removed)
        removed |= roof
        assert np.array_equal(removed, heights >= lowest)


def test_roofs_that_differ_by_little_are_one() -> None:
    """By more than a limit for neighbours and less than one for what lies below they would keep each other."""
    heights = land()
    heights[10:20, 8:13] = 5000
    heights[10:20, 13:18] = 6200
    assert np.array_equal(plateaus(heights, RULE), heights > 0)


def test_what_a_hill_leans_on_is_kept() -> None:
    """A terrace below a roof that was removed by mistake sees terrain above it, farther up."""
    heights = land()
    heights[:10] = 9000
    heights[10:15] = 5000
    removed = np.zeros(heights.shape, bool)
    removed[8:10, 10:20] = True
    assert not plateaus(np.where(removed, EMPTY, heights).astype(np.int32), RULE, removed).any()


@pytest.mark.parametrize(
    "why",
    [
        "ramp",
        "wide",
        "low",
        "pit",
        "terrace",
        "slope",
        "higher beside",
        "out of sight",
        "alone",
    ],
)
def test_terrain_is_kept(why: str) -> None:
    heights, rule = land(), RULE
    heights[10:20, 8:18] = 5000
    if why == "ramp":
        heights[15, 18:24] = [4200, 3400, 2600, 1800, 1000, 200]
    elif why == "wide":
        rule = replace(RULE, widest=9)
    elif why == "low":
        heights[10:20, 8:18] = 1500
    elif why == "pit":
        heights[10:20, 8:18] = -5000
    elif why == "terrace":
        heights[:, 8:18] = 0
        heights[:10] = 5000
        rule = replace(RULE, widest=100)
    elif why == "slope":
        # A clearing in a wood on a hill: the ground seen four cells away is lower by 1 m a
        # cell, as on any slope.
        heights[7:23, 5:21] = EMPTY
        heights[10:20, 8:18] = 4500
        rule = replace(RULE, slope=800.0)
    elif why == "higher beside":
        heights[10:20, 18:28] = 9000
    elif why == "out of sight":
        heights[4:26, 2:24] = EMPTY
        heights[10:20, 8:18] = 5000
    else:
        heights[heights == 0] = EMPTY
    assert not plateaus(heights, rule)[10:20, 8:18].any()


def by_hand(
    heights: np.ndarray, rule: Plateaus, removed: np.ndarray, data: np.ndarray
) -> np.ndarray:
    """The rule word by word."""
    gone = {(int(r), int(c)) for r, c in np.argwhere(removed)}
    filled = {(int(r), int(c)): int(heights[r, c]) for r, c in np.argwhere(heights != EMPTY)}

    def first(
        cell: tuple[int, int], way: tuple[int, int], farthest: int
    ) -> tuple[int, int] | None:
        ahead = ((cell[0] + k * way[0], cell[1] + k * way[1]) for k in range(1, farthest + 1))
        return next((place for place in ahead if place in filled), None)

    def says(cell: tuple[int, int], other: tuple[int, int] | None) -> str:
        if other is None:
            return "nothing"
        lower, steps = (
            filled[cell] - filled[other],
            max(abs(cell[0] - other[0]), abs(cell[1] - other[1])),
        )
        if lower <= rule.fall:
            return "other"
        return "falls" if lower > rule.fall + rule.slope * steps else "nothing"

    def leaves(cell: tuple[int, int], way: tuple[int, int]) -> bool:
        ahead = ((cell[0] + k * way[0], cell[1] + k * way[1]) for k in range(1, rule.view + 1))
        return not any(
            0 <= r < data.shape[0] and 0 <= c < data.shape[1] and data[r, c] for r, c in ahead
        )

    def joined(
        cell: tuple[int, int], way: tuple[int, int], other: tuple[int, int] | None
    ) -> bool:
        near = [(cell[0] + k * way[0], cell[1] + k * way[1]) for k in (1, 2)]
        until = near[: near.index(other) + 1] if other in near else near
        return any(place in gone for place in until[: rule.view])

    found, left = np.zeros(heights.shape, bool), set(filled)
    while left:
        surface, waiting = set(), [min(left)]
        while waiting:
            cell = waiting.pop()
            surface.add(cell)
            near = (first(cell, way, rule.gap) for way in WAYS)
            waiting += [
                n
                for n in near
                if n and n not in surface and abs(filled[n] - filled[cell]) <= rule.step
            ]
        left -= surface
        looks = [(cell, way, first(cell, way, rule.view)) for cell in surface for way in WAYS]
        looks = [(cell, way, n) for cell, way, n in looks if n not in surface]
        said = Counter(says(cell, n) for cell, way, n in looks)
        past = sum(
            says(cell, n) == "nothing" and joined(cell, way, n) for cell, way, n in looks
        )
        leave = Counter(
            way
            for cell, way, n in looks
            if n is None and not joined(cell, way, n) and leaves(cell, way)
        )
        through = any(min(leave[a, b], leave[-a, -b]) >= 3 for a, b in ((0, 1), (1, 0)))
        limit = rule.widest_cut if leave.total() > 0.02 * len(looks) else rule.widest
        falls, seen, unseen = (
            said["falls"],
            said["falls"] + said["other"],
            said["nothing"] - past,
        )
        wide = max(np.ptp([r for r, _ in surface]), np.ptp([c for _, c in surface])) + 1
        if seen and falls >= rule.share * seen and unseen <= rule.unseen * len(looks):
            for cell in surface if wide <= limit and not through else ():
                found[cell] = True
    return found


@st.composite
def blocky(draw: st.DrawFn) -> np.ndarray:
    """Blocks of few heights, some of them empty."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    coarse = random.choice([EMPTY, 0, 0, 800, 3000, 5000], (9, 9)).astype(np.int32)
    fine = np.kron(coarse, np.ones((3, 3), np.int32)).astype(np.int32)
    fine[random.random(fine.shape) < 0.1] = EMPTY
    return fine


@settings(max_examples=20, deadline=None)
@given(blocky(), st.integers(1, 3), st.integers(1, 5), st.integers(1, 12), st.booleans())
def test_it_is_the_rule_and_sees_no_farther_than_it_says(
    heights: np.ndarray, gap: int, view: int, widest: int, again: bool
) -> None:
    removed, data = (heights == 5000) & again, (heights != EMPTY) | (np.arange(27) % 4 > 0)
    limits = {"widest": widest, "widest_cut": max(widest - 3, 1)}
    rule = replace(RULE, gap=gap, view=view, slope=700.0, share=0.7, **limits)
    heights = np.where(removed, EMPTY, heights).astype(np.int32)
    found = plateaus(heights, rule, removed, data)
    assert np.array_equal(found, by_hand(heights, rule, removed, data))
    for row, column in ((13, 13), (0, 5), (20, 26)):
        south, west = max(row - rule.reach, 0), max(column - rule.reach, 0)
        near = np.s_[south : row + rule.reach + 1, west : column + rule.reach + 1]
        seen, *others = (np.ascontiguousarray(a[near]) for a in (heights, removed, data))
        part = plateaus(seen, rule, *others)
        assert part[row - south, column - west] == found[row, column]


def partly_removed() -> np.ndarray:
    """Of a hall one side was removed, and interpolated from the ground beside it."""
    heights = with_hall()
    heights[40:70, 50:56] = PLAIN[40:70, 50:56]
    return heights


def with_ramps() -> np.ndarray:
    """Of a low hall the DTM interpolates the walls over three cells, as between sparse points."""
    heights = with_hall(4.0)
    for away, height in ((1, 2.8), (2, 1.4)):
        edge = np.zeros(heights.shape, bool)
        edge[40 - away : 70 + away, 50 - away : 80 + away] = True
        edge[41 - away : 69 + away, 51 - away : 79 + away] = False
        heights[edge] = PLAIN[edge] + height
    return heights


def with_annexe() -> np.ndarray:
    """A flat roof 56 m wide with a parapet, and beside it one that is 1.2 m lower."""
    heights = with_hall(10.0, slice(40, 68), slice(50, 78))
    heights[40:68, 78:90] = PLAIN[40:68, 78:90] + 8.8
    rim = np.zeros(heights.shape, bool)
    rim[40:68, 50:78] = True
    rim[41:67, 51:77] = False
    heights[rim] += 1.2
    return heights


@pytest.mark.parametrize(
    ("heights", "width", "middle"),
    [
        (with_hall(), 60, (55, 65)),
        (with_hall(pitch=0.8), 60, (55, 65)),
        (with_hall(columns=slice(20, 130)), 60, (55, 75)),
        (with_hall(rows=slice(30, 100), columns=slice(40, 120)), 140, (65, 80)),
        (with_hall() + 0.3 * ROWS, 60, (55, 65)),
        (partly_removed(), 48, (55, 68)),
        (with_annexe(), 56, (54, 64)),
        (with_ramps(), 62, (55, 65)),
    ],
    ids=[
        "level",
        "gabled",
        "long",
        "wide",
        "on a slope",
        "partly removed",
        "with an annexe",
        "with ramps",
    ],
)
def test_a_roof_is_found_with_its_place_and_width(
    heights: np.ndarray, width: float, middle: tuple[float, float]
) -> None:
    roof = max(remaining_roofs(heights))  # an annexe is one of its own
    assert roof.width_m == pytest.approx(width, abs=4)
    assert (roof.row, roof.column) == (
        pytest.approx(middle[0], abs=2),
        pytest.approx(middle[1], abs=2),
    )
    assert remaining_roofs(heights, min_width_m=2 * width) == []


ridge = np.abs(COLUMNS - 75)


@pytest.mark.parametrize(
    "heights",
    [
        PLAIN,
        with_hall(1.5),
        with_hall(-8.0),
        with_hall(columns=slice(50, 150)),
        -0.8 * ridge,
        np.maximum(0, 30 - np.hypot(ROWS - 60, COLUMNS - 75)),
        np.clip(40 - ridge, 0, 8),
        np.full((9, 9), np.nan),
        PLAIN[:0],
    ],
    ids=[
        "plain",
        "podium",
        "pit",
        "terrace",
        "ridge",
        "cone",
        "embankment",
        "unknown",
        "nothing",
    ],
)
def test_terrain_is_no_roof(heights: np.ndarray) -> None:
    assert remaining_roofs(heights, min_width_m=10.0) == []


def test_a_roof_among_unknown_heights_is_none() -> None:
    heights = with_hall()
    heights[:, 84:] = np.nan
    assert len(remaining_roofs(heights)) == 1  # on three sides it is seen to fall
    heights[:40], heights[70:] = np.nan, np.nan
    assert remaining_roofs(heights) == []


@pytest.mark.parametrize(
    "heights", [with_hall(), with_hall(pitch=0.8), partly_removed(), with_annexe()]
)
def test_what_is_found_is_what_the_filter_removes(heights: np.ndarray) -> None:
    """One point a cell; the cells of the roofs that are found are those of the points that are taken out."""
    x, y = ((2000 * c + 1000).ravel().astype(np.int32) for c in (COLUMNS, ROWS))
    z = np.rint(1000 * heights).ravel().astype(np.int32)
    raster, ground = CellRaster(x, y, CellLattice(2000, 1, 0, 0)), np.ones(z.size, bool)
    for step_m in ROOF_STEPS_M:
        ground &= ~on_plateaus(z, ground, ~ground, raster, Plateaus.of(Scale(), 240.0, step_m))
    terrain = np.where(ground.reshape(heights.shape), heights, PLAIN)
    assert 0 < (~ground).sum() < 2000
    assert remaining_roofs(heights)
    assert remaining_roofs(terrain) == []
