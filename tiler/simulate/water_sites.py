"""Kinds of sites with water of known extent and level, and a wet meadow without water."""

from __future__ import annotations

import numpy as np

from ptd.arrays import Float64
from tiler.simulate.blocks import bridge
from tiler.simulate.objects import Objects, Solid
from tiler.simulate.site import Plot, Site
from tiler.simulate.terrain import (
    FACE_SLOPE,
    Field,
    Line,
    Masonry,
    Terrain,
    WaterBody,
    Waters,
    Waves,
    constant,
)

BANK_TREES_M = 9.0
"""Width of the strip along a shore on which trees grow."""

OVERHANG_M = 4.0
"""Largest distance in metres by which crowns reach over the water."""

REED_BANK_M = 6.0
"""Width of a bank of reed."""


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def bank_trees(plot: Plot) -> None:
    """Place trees along the shores, with crowns that reach over the water."""
    waters = plot.terrain.waters
    if waters is None:
        return
    for _ in range(round(plot.side**2 / 25)):
        x, y = plot.pick()
        tall, crown = plot.rng.uniform(6.0, 14.0), plot.rng.uniform(2.5, 5.0)
        place = np.array([x]), np.array([y])
        shore = float(waters.shore_m(*place)[0])
        on_bank = max(0.5, crown - OVERHANG_M) < shore < BANK_TREES_M
        if not on_bank:
            continue
        ground = plot.ground(x, y)
        if not any(block.height_at(*place)[0] > ground - 0.5 for block in waters.masonry):
            plot.tree(x, y, tall, widest=crown, rooted=0.1)


def weir(seed: int, side_m: float) -> Site:
    """A river with a dam of 3 m, a lock wall, piers, tailwater with waves, a tributary, trees over both banks."""
    rng = _rng(seed)
    north, dam, mouth = 260.0, 0.43 * side_m, 0.8 * side_m
    pool_level, tail_level = 143.4, 140.4
    phase = rng.uniform(0.0, 2 * np.pi)

    def middle(x: Float64) -> Float64:
        return np.asarray(130.0 + 12.0 * np.sin(2 * np.pi * x / 520.0 + phase))

    at_dam, at_mouth = (float(middle(np.array(x))) for x in (dam, mouth))

    def pool_shore(x: Float64, y: Float64) -> Float64:
        return np.maximum(np.abs(y - middle(x)) - 19.0, x - dam)

    def tail_shore(x: Float64, y: Float64) -> Float64:
        return np.maximum(np.abs(y - middle(x)) - 17.0, dam + 6.0 - x)

    def tributary_shore(x: Float64, y: Float64) -> Float64:
        across = x - mouth - 0.2 * (y - 130.0)
        return np.maximum(np.abs(across) - 9.0, at_mouth - y)

    def below(x: Float64, y: Float64) -> Float64:
        return np.asarray(tail_level - 0.0005 * (x - dam) + 0.0 * y)

    def tributary_level(x: Float64, y: Float64) -> Float64:
        return below(np.full_like(x, mouth), y) + 0.002 * np.maximum(y - at_mouth - 17.0, 0.0)

    def rough(calm: float, broken: float) -> Field:
        return lambda x, y: np.where(x < dam + 156.0, broken, calm) + 0.0 * y

    bodies = (
        WaterBody(pool_shore, constant(pool_level), 0.5, constant(0.08), low=0.001),
        WaterBody(tributary_shore, tributary_level, 0.5, constant(0.04)),
        WaterBody(tail_shore, below, 0.5, rough(0.05, 0.85), rough(0.02, 0.12), low=0.001),
    )
    piers = [
        Masonry(dam - 1.0, at_dam + across, dam + 9.0, at_dam + across + 2.0, pool_level + 2.0)
        for across in (-7.0, 0.0, 7.0)
    ]
    crest = Masonry(dam, at_dam - 50.0, dam + 6.0, at_dam + 50.0, pool_level + 0.7)
    lock = Masonry(dam - 40.0, at_dam - 16.0, dam + 45.0, at_dam - 13.0, pool_level + 1.2)
    waters = Waters(bodies, (crest, lock, *piers))
    terrain = Terrain(146.5, (0.0, 0.0), (Waves.random(rng, 1.2, 180.0),), waters)
    return Site(terrain, side_m, seed, bank_trees, 40.0, green=0.8, north_m=north)


def meander(seed: int, side_m: float) -> Site:
    """A river that falls 1 m per km around bends: a bar, an island of gravel, a ford, a bridge, low banks."""
    rng = _rng(seed)
    bend, swing, phase = 480.0, 60.0, rng.uniform(0.0, 2 * np.pi)
    bar_x, gravel_x, ford_x, deck_x = (share * side_m for share in (0.4, 0.76, 0.6, 0.22))

    def middle(x: Float64) -> Float64:
        return np.asarray(150.0 + swing * np.sin(2 * np.pi * x / bend + phase))

    def steepness(x: Float64) -> Float64:
        return np.asarray(2 * np.pi / bend * swing * np.cos(2 * np.pi * x / bend + phase))

    at_bar, at_gravel, at_deck = (float(middle(np.array(x))) for x in (bar_x, gravel_x, deck_x))

    def shore(x: Float64, y: Float64) -> Float64:
        wide = 18.0 * np.exp(-(((x - gravel_x) / 90.0) ** 2))
        river = np.abs(y - middle(x)) / np.hypot(1.0, steepness(x)) - (
            14.0 + 3.0 * np.sin(x / 70.0) + wide
        )
        bar = 8.0 - np.hypot((x - bar_x) / 2.2, y - at_bar - 9.0)
        gravel = 14.0 - np.hypot((x - gravel_x) / 3.6, y - at_gravel)
        dry = np.maximum(
            np.where(bar > 0.0, bar, -99.0), np.where(gravel > 0.0, gravel / 6.0, -99.0)
        )
        return np.maximum(river, dry)

    def level(x: Float64, y: Float64) -> Float64:
        return np.asarray(52.0 - 0.001 * x + 0.0 * y)

    def ford(elsewhere: float, there: float) -> Field:
        return lambda x, y: np.where(np.abs(x - ford_x) < 30.0, there, elsewhere) + 0.0 * y

    body = WaterBody(shore, level, 0.3, ford(0.04, 0.8), ford(0.02, 0.08))
    terrain = Terrain(54.0, (-0.001, 0.0), (Waves.random(rng, 0.6, 150.0),), Waters((body,)))
    across = float(np.degrees(np.arctan(steepness(np.array(deck_x))))) + 90.0
    deck = bridge(terrain, Line(deck_x, at_deck, across), 60.0, 9.0)
    return Site(terrain, side_m, seed, None, landmarks=deck, green=0.8, north_m=300.0)


def quay_trees(plot: Plot) -> None:
    """Place large trees along the northern quay of a canal, with crowns that reach far over the water."""
    waters = plot.terrain.waters
    if waters is None:
        return
    for _ in range(round(plot.side**2 / 12)):
        x, y = plot.pick()
        tall = plot.rng.uniform(8.0, 14.0)
        shore, south = (
            float(waters.shore_m(np.array([x]), np.array([at]))[0]) for at in (y, y - 2.0)
        )
        if 0.7 < shore < 2.0 and south < shore:
            plot.tree(x, y, tall, widest=7.0, rooted=0.1)


def canal(seed: int, side_m: float) -> Site:
    """A canal between upright quays that leaves the survey aslant: trees over one quay, houses on the other."""
    rng = _rng(seed)
    half_width, level, quay = 16.0, -0.4, 0.9
    tilt = np.radians(rng.uniform(25.0, 40.0))
    middle = side_m / 2

    def across(x: Float64, y: Float64) -> Float64:
        return np.asarray((y - middle) * np.cos(tilt) - (x - middle) * np.sin(tilt))

    def shore(x: Float64, y: Float64) -> Float64:
        return np.asarray(np.abs(across(x, y)) - half_width)

    body = WaterBody(shore, constant(level), FACE_SLOPE, constant(0.03))
    terrain = Terrain(
        level + quay, (0.0, 0.0), (Waves.random(rng, 0.2, 120.0),), Waters((body,))
    )
    row = Line(middle, middle, float(np.degrees(tilt)))
    houses = []
    for along in np.arange(-0.3 * side_m, 0.3 * side_m, 14.0):
        x, y = row.at(float(along), -half_width - 5.5)
        top = level + quay + rng.uniform(8.0, 12.0)
        houses.append(Solid(x, y, row.angle_deg, 8.0, 10.0, level, top, pitch=0.8))
    return Site(
        terrain, side_m, seed, quay_trees, 40.0, Objects(solids=tuple(houses)), green=0.4
    )


def _lobed(x0: float, y0: float, radius: float, lobes: int) -> Field:
    """Return the field of the distance from a round shore with ``lobes`` lobes, in metres."""

    def shore(x: Float64, y: Float64) -> Float64:
        angle = np.arctan2(y - y0, x - x0)
        return np.asarray(
            np.hypot(x - x0, y - y0) - radius * (1.0 + 0.15 * np.sin(lobes * angle))
        )

    return shore


def lakes(seed: int, side_m: float) -> Site:
    """Three lakes of different levels: a dam between two, a bank of reed, one at the border cut by two strips."""
    rng = _rng(seed)
    unit = side_m / 640.0
    dam = 212.0 * unit
    upper, lower = (
        _lobed(x * unit, 180.0 * unit, r * unit, n) for x, r, n in ((140, 70, 3), (300, 75, 4))
    )

    def upper_shore(x: Float64, y: Float64) -> Float64:
        return np.maximum(upper(x, y), x - dam)

    def lower_shore(x: Float64, y: Float64) -> Float64:
        return np.maximum(lower(x, y), dam + 10.0 - x)

    def reeds(x: Float64, y: Float64) -> Float64:
        return np.where((upper_shore(x, y) > -REED_BANK_M) & (x < 110.0 * unit), 0.9, 0.0)

    def strips(x: Float64, y: Float64) -> Float64:
        return np.where(x < 500.0 * unit, 0.0, 0.4) + 0.0 * y

    border = _lobed(500.0 * unit, 40.0 * unit, 80.0 * unit, 3)
    bodies = (
        WaterBody(upper_shore, constant(99.0), 0.25, reeds=reeds),
        WaterBody(lower_shore, constant(97.0), 0.25),
        WaterBody(border, constant(94.0), 0.25, constant(0.15), tide_m=strips),
    )
    crest = Masonry(dam, 120.0 * unit, dam + 10.0, 240.0 * unit, 100.2)
    terrain = Terrain(
        102.0, (0.0, 0.0), (Waves.random(rng, 1.5, 160.0),), Waters(bodies, (crest,))
    )
    return Site(terrain, side_m, seed, bank_trees, 40.0, green=0.8, north_m=300.0 * unit)


def tide(seed: int, side_m: float) -> Site:
    """A beach along a sea that was 0.6 m lower when the eastern half was surveyed."""
    rng = _rng(seed)
    phase, beach_slope, fall = rng.uniform(0.0, 2 * np.pi), 0.05, 0.6

    def fallen(x: Float64) -> Float64:
        return np.asarray(fall * np.clip(x - side_m / 2, 0.0, 1.0))

    def shore(x: Float64, y: Float64) -> Float64:
        return np.asarray(150.0 - y - 15.0 * np.sin(x / 60.0 + phase) + fallen(x) / beach_slope)

    def level(x: Float64, y: Float64) -> Float64:
        return np.asarray(1.1 - fallen(x) + 0.0 * y)

    body = WaterBody(shore, level, beach_slope, constant(0.3), constant(0.08))
    terrain = Terrain(5.0, (0.0, 0.0), (Waves.random(rng, 0.5, 140.0),), Waters((body,)))
    return Site(terrain, side_m, seed, green=0.6, north_m=260.0)


def wet_meadow(seed: int, side_m: float) -> Site:
    """Flat land without open water, with wet, dark patches that return only a third of the pulses."""
    rng = _rng(seed)
    phase = rng.uniform(0.0, 2 * np.pi)

    def lost(x: Float64, y: Float64) -> Float64:
        return np.where(np.sin(x / 30.0 + phase) + np.sin(y / 25.0) > 0.8, 0.65, 0.01)

    terrain = Terrain(
        10.0, (0.0, 0.0), (Waves.random(rng, 0.12, 60.0),), Waters(lost_on_land=lost)
    )
    return Site(terrain, side_m, seed, green=0.9, north_m=0.75 * side_m)
