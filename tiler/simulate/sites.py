"""Kinds of sites, such as a city, a forest, a quarry or a river, each made from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptd.arrays import Float64, UInt8
from tiler.errors import ConfigError
from tiler.simulate import blocks
from tiler.simulate.als import AlsSensor
from tiler.simulate.blocks import bridge, power_line
from tiler.simulate.objects import Objects
from tiler.simulate.points import Sensor, survey
from tiler.simulate.site import Site
from tiler.simulate.terrain import (
    Bank,
    Basin,
    Cliff,
    Embankment,
    Hill,
    Line,
    Ridge,
    River,
    Terraces,
    Terrain,
    Waves,
)
from tiler.simulate.water_sites import canal, lakes, meander, tide, weir, wet_meadow


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def _tilt(east: float, north: float, side_m: float) -> tuple[float, float]:
    """Return a slope, which is gentler on sites with sides above 400 m.

    One flying height must suit the whole site.
    """
    share = min(1.0, 400.0 / side_m)
    return east * share, north * share


def city(seed: int, side_m: float) -> Site:
    """City blocks of 50 m on gentle hills with a dam, a river bank and a power line."""
    rng = _rng(seed)
    dam = Embankment(
        side_m / 2, side_m * 0.78, 12.0, height=5.0, crest_width=6.0, slope_width=9.0
    )
    bank = Bank(side_m * 0.86, drop=6.0, width=4.0, swing=side_m * 0.04, period=side_m * 0.9)
    terrain = Terrain(
        120.0, _tilt(0.01, -0.006, side_m), (Waves.random(rng, 9.0, 380.0), dam, bank)
    )
    line = power_line(terrain, Line(0.0, side_m * 0.93, 2.0), side_m)
    return Site(terrain, side_m, seed, blocks.city_block, 50.0, line, street_m=5.0, green=0.55)


def suburb(seed: int, side_m: float) -> Site:
    """Houses and gardens on rolling land, with a pond and a cutting below a road bridge."""
    rng = _rng(seed)
    cutting = Embankment(
        side_m * 0.5, side_m * 0.3, 5.0, height=-5.0, crest_width=9.0, slope_width=7.0
    )
    pond = Basin(side_m * 0.78, side_m * 0.75, 18.0, 2.0, 4.0, water=True)
    terrain = Terrain(
        210.0, _tilt(0.02, 0.03, side_m), (Waves.random(rng, 10.0, 260.0), cutting, pond)
    )
    deck = bridge(terrain, Line(side_m * 0.46, side_m * 0.297, 95.0), 26.0, 8.0)
    return Site(terrain, side_m, seed, blocks.suburb_block, 36.0, deck, street_m=3.0, green=0.8)


def forest(seed: int, side_m: float) -> Site:
    """Closed wood with clearings, on hills with the valley of a stream."""
    rng = _rng(seed)
    hills = [
        Hill(
            rng.uniform(0, side_m),
            rng.uniform(0, side_m),
            rng.uniform(8, 30),
            rng.uniform(25, 60),
        )
        for _ in range(min(max(3, int(6 * (side_m / 200) ** 2)), 40))
    ]
    stream = River(Line(side_m * 0.35, 0.0, 80.0), 1.5, 4.0, 9.0, swing=12.0, period=120.0)
    terrain = Terrain(
        400.0,
        _tilt(0.15, 0.1, side_m),
        (*hills, Waves.random(rng, 6.0, 50.0), Waves.random(rng, 0.5, 8.0), stream),
    )
    return Site(terrain, side_m, seed, blocks.forest_block, 25.0, green=0.3)


def mountain(seed: int, side_m: float) -> Site:
    """Sharp ridges of 35-45 degrees, for which `ridge2016` is made, and a settled valley."""
    rng = _rng(seed)
    ridges = [
        Ridge(Line(side_m * 0.8, side_m * 0.55, 85.0), 75.0, 82.0, side_m * 1.2),
        Ridge(Line(side_m * 0.65, side_m * 0.85, 15.0), 42.0, 50.0, side_m * 0.7),
        Ridge(Line(side_m * 0.72, side_m * 0.25, -20.0), 30.0, 40.0, side_m * 0.5),
    ]
    rough = (Waves.random(rng, 3.0, 70.0), Waves.random(rng, 0.8, 12.0))
    terrain = Terrain(800.0, _tilt(0.05, 0.02, side_m), (*ridges, *rough))
    line = power_line(terrain, Line(0.0, side_m * 0.45, 8.0), side_m)
    return Site(
        terrain, side_m, seed, blocks.mountain_block, 36.0, line, street_m=2.0, green=0.5
    )


def terraces(seed: int, side_m: float) -> Site:
    """Vineyard terraces with steep faces below a cliff, and a retaining wall."""
    rng = _rng(seed)
    steps = Terraces(
        Line(0.0, side_m * 0.15, 6.0), min(max(2, int(side_m * 0.45 / 13)), 12), 13.0, 2.4, 0.9
    )
    cliff = Cliff(Line(0.0, side_m * 0.72, -4.0), 28.0, 9.0, swing=7.0, period=90.0)
    wall = Cliff(Line(side_m * 0.5, side_m * 0.09, 6.0), 3.0, 0.3)
    terrain = Terrain(
        300.0, _tilt(0.03, 0.08, side_m), (steps, cliff, wall, Waves.random(rng, 3.0, 90.0))
    )
    return Site(terrain, side_m, seed, blocks.terrace_block, 40.0, green=0.5)


def quarry(seed: int, side_m: float) -> Site:
    """A pit with benches, a spoil heap, a railway embankment, works and bushes."""
    rng = _rng(seed)
    pit = Basin(side_m * 0.38, side_m * 0.42, side_m * 0.27, 36.0, side_m * 0.13, benches=3)
    pool = Basin(side_m * 0.38, side_m * 0.40, side_m * 0.05, 3.0, 3.0, water=True)
    heap = Ridge(Line(side_m * 0.8, side_m * 0.25, 60.0), 14.0, 22.0, 50.0)
    dam = Embankment(
        side_m * 0.5, side_m * 0.85, -6.0, height=7.0, crest_width=5.0, slope_width=10.0
    )
    terrain = Terrain(
        150.0,
        _tilt(-0.02, 0.03, side_m),
        (Waves.random(rng, 4.0, 140.0), Waves.random(rng, 0.6, 9.0), pit, pool, heap, dam),
    )
    return Site(terrain, side_m, seed, blocks.works_block, 40.0, street_m=2.0, green=0.3)


def river(seed: int, side_m: float) -> Site:
    """A river and a pond with hardly any returns, two bridges, and houses on the banks."""
    rng = _rng(seed)
    course = Line(side_m * 0.5, 0.0, 84.0)
    stream = River(course, side_m * 0.14, 5.0, 9.0, swing=side_m * 0.05, period=side_m * 1.1)
    pond = Basin(side_m * 0.15, side_m * 0.8, side_m * 0.07, 2.5, 6.0, water=True)
    terrain = Terrain(
        30.0, _tilt(0.0, 0.002, side_m), (Waves.random(rng, 1.2, 200.0), stream, pond)
    )
    decks = Objects()
    for share in (0.3, 0.75):
        along = share * side_m
        sway = -stream.swing * np.sin(2 * np.pi * along / stream.period)
        turn = np.radians(course.angle_deg)
        x, y = (
            course.x + along * np.cos(turn) - sway * np.sin(turn),
            along * np.sin(turn) + sway * np.cos(turn),
        )
        decks = decks + bridge(terrain, Line(x, y, -6.0), stream.width + 24.0, 9.0)
    return Site(
        terrain, side_m, seed, blocks.river_block, 40.0, decks, street_m=3.0, green=0.75
    )


def halls(seed: int, side_m: float) -> Site:
    """Large halls, podiums and courtyards on nearly flat land with a road embankment."""
    rng = _rng(seed)
    ramp = Embankment(
        side_m * 0.98, side_m * 0.5, 90.0, height=4.0, crest_width=8.0, slope_width=6.0
    )
    terrain = Terrain(60.0, _tilt(0.008, 0.004, side_m), (Waves.random(rng, 2.5, 300.0), ramp))
    return Site(terrain, side_m, seed, blocks.hall_block, 100.0, street_m=8.0, green=0.35)


def mixed(seed: int, side_m: float) -> Site:
    """Houses, fields and wood on hills with a road embankment."""
    rng = _rng(seed)
    dam = Embankment(
        side_m * 0.4, side_m * 0.5, 70.0, height=4.0, crest_width=8.0, slope_width=7.0
    )
    terrain = Terrain(250.0, _tilt(0.03, -0.02, side_m), (Waves.random(rng, 22.0, 260.0), dam))
    return Site(terrain, side_m, seed, blocks.mixed_block, 42.0, street_m=3.0, green=0.7)


def village(seed: int, side_m: float) -> Site:
    """Houses and gardens on a slope of about 15 degrees, with terraces, a gully and scrub."""
    rng = _rng(seed)
    gully = River(Line(side_m * 0.7, 0.0, 70.0), 0.5, 5.0, 11.0, swing=6.0, period=70.0)
    steps = Terraces(Line(0.0, side_m * 0.2, 10.0), 3, 16.0, 1.8, 0.8)
    terrain = Terrain(
        2300.0,
        _tilt(0.1, 0.22, side_m),
        (Waves.random(rng, 6.0, 90.0), Waves.random(rng, 0.4, 8.0), gully, steps),
    )
    return Site(terrain, side_m, seed, blocks.suburb_block, 32.0, street_m=2.5, green=0.45)


def park(seed: int, side_m: float) -> Site:
    """Lawns, trees, meadows and hedges, with a pond and some buildings."""
    rng = _rng(seed)
    pond = Basin(side_m * 0.3, side_m * 0.3, 11.0, 1.2, 3.0, water=True)
    terrain = Terrain(
        40.0,
        _tilt(0.02, 0.01, side_m),
        (Waves.random(rng, 4.0, 90.0), Waves.random(rng, 0.3, 9.0), pond),
    )
    return Site(terrain, side_m, seed, blocks.park_block, 30.0, green=0.95)


def rows(seed: int, side_m: float) -> Site:
    """Terraced houses on flat land, with a canal."""
    rng = _rng(seed)
    canal = River(Line(0.0, side_m * 0.62, 0.0), 9.0, 1.5, 2.5)
    terrain = Terrain(2.0, _tilt(0.002, 0.001, side_m), (Waves.random(rng, 0.5, 80.0), canal))
    return Site(terrain, side_m, seed, blocks.row_block, 44.0, street_m=3.5, green=0.5)


def industry(seed: int, side_m: float) -> Site:
    """Large flat halls, yards of trailers and parking on nearly flat land."""
    rng = _rng(seed)
    terrain = Terrain(140.0, _tilt(0.006, -0.004, side_m), (Waves.random(rng, 1.5, 220.0),))
    return Site(terrain, side_m, seed, blocks.industry_block, 105.0, street_m=6.0, green=0.3)


def bluff(seed: int, side_m: float) -> Site:
    """A closed wood on a bluff of about 60 m with rocky steps, between meadows and houses."""
    rng = _rng(seed)
    face = Cliff(Line(0.0, side_m * 0.3, 9.0), 55.0, 60.0, swing=12.0, period=140.0)
    steps = Cliff(Line(0.0, side_m * 0.42, 6.0), 6.0, 2.5, swing=9.0, period=70.0)
    rough = (Waves.random(rng, 5.0, 60.0), Waves.random(rng, 1.0, 11.0))
    terrain = Terrain(180.0, _tilt(0.01, 0.02, side_m), (face, steps, *rough))
    return Site(terrain, side_m, seed, blocks.bluff_block, 32.0, street_m=2.0, green=0.7)


def plane(seed: int, side_m: float) -> Site:
    """A bare tilted plane."""
    return Site(Terrain(100.0, _tilt(0.05, -0.03, side_m)), side_m, seed)


def hills(seed: int, side_m: float) -> Site:
    """Bare hills with a dam and a river bank."""
    rng = _rng(seed)
    mounds = []
    for _ in range(6):
        x, y, radius = (
            rng.uniform(0, side_m),
            rng.uniform(0, side_m),
            rng.uniform(0.1, 0.3) * side_m,
        )
        mounds.append(Hill(x, y, rng.uniform(-8, 15), radius))
    dam = Embankment(side_m / 2, side_m * 0.75, 15.0, 4.0, 5.0, 7.0)
    bank = Bank(side_m * 0.8, 5.0, 3.0, side_m * 0.05, side_m)
    return Site(Terrain(100.0, (0.0, 0.0), (*mounds, dam, bank)), side_m, seed)


SITES: dict[str, Callable[[int, float], Site]] = {
    make.__name__: make
    for make in (
        city,
        suburb,
        forest,
        mountain,
        terraces,
        quarry,
        river,
        halls,
        mixed,
        village,
        park,
        rows,
        industry,
        bluff,
        plane,
        hills,
        weir,
        meander,
        canal,
        lakes,
        tide,
        wet_meadow,
    )
}
"""Functions ``(seed, side_m) -> Site`` by the name of the kind of site."""


def make_site(kind: str, seed: int, side_m: float) -> Site:
    """Return a site of a kind in `SITES`. Raise ConfigError if there is no such kind."""
    if kind not in SITES:
        raise ConfigError(f"unknown scene {kind!r}: choose one of {', '.join(SITES)}")
    return SITES[kind](seed, side_m)


def scene_points(
    kind: str = "city", seed: int = 1, side_m: float = 100.0, sensor: Sensor | None = None
) -> tuple[Float64, UInt8]:
    """Return the points of a site and their reference classes.

    Parameters
    ----------
    kind : str
        Name in `SITES`.
    seed : int
        Seed of the site. The same seed gives the same points.
    side_m : float
        Side of the site, metres.
    sensor : AlsSensor or DimSensor, optional
        Sensor with its density, noise and blunders. The default is `AlsSensor` with its defaults.

    Returns
    -------
    xyz : float64, shape (n, 3), metres
    labels : uint8, shape (n,)
        Labels as in `tiler.simulate.points.SimulatedPoints`.
    """
    points = survey(make_site(kind, seed, side_m), sensor or AlsSensor())
    return points.xyz, points.label
