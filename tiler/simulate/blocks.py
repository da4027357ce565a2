"""Objects on the land: functions that fill a plot, one per kind of block, and bridges and power lines across blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tiler.simulate.objects import BRIDGE, TOWER, Objects, Solid, Wire
from tiler.simulate.site import Plot
from tiler.simulate.terrain import Line, Terrain


def city_block(plot: Plot) -> None:
    """Place flats, a courtyard, a podium with a tower, a parking lot or a park."""
    kind = plot.rng.random()
    done = False
    if kind < 0.2:
        done = plot.courtyard(plot.rng.uniform(9, 12), closed=bool(plot.rng.random() < 0.6))
    elif kind < 0.3:
        done = plot.podium()
    elif kind < 0.38:
        plot.parking()
        done = True
    elif kind < 0.82:
        angle = float(plot.rng.choice([0.0, 0.0, 90.0, plot.rng.uniform(0, 180)]))
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        across = plot.rng.uniform(10, 12)
        done = plot.flats(plot.x - across * sin, plot.y + across * cos, angle)
        if plot.rng.random() < 0.6:
            done |= plot.flats(plot.x + across * sin, plot.y - across * cos, angle)
    if done:
        plot.trees(1, 5)
        plot.bushes(1, 4)
    else:
        plot.trees(6, 16, (5.0, 18.0))
        plot.bushes(3, 8)
    plot.street_cars(0.4)


def suburb_block(plot: Plot) -> None:
    """Place up to two houses with gardens, hedges and walls, or a wood on steep land."""
    if plot.slope() > 0.4:
        plot.wood(5.0, (8.0, 20.0), 0.3)
        return
    angle = float(plot.rng.choice([0.0, 90.0, plot.rng.uniform(0, 180)]))
    built = plot.house(*plot.pick(15.0), angle)
    if plot.rng.random() < 0.3:
        built |= plot.house(*plot.pick(10.0), angle)
    if not built and plot.rng.random() < 0.5:
        plot.undergrowth(plot.rng.uniform(0.3, 0.9), plot.rng.uniform(0.2, 0.9))
    if plot.rng.random() < 0.3:
        plot.dugout(*plot.pick(6.0))
    plot.trees(2, 7, (3.0, 12.0))
    plot.bushes(2, 6)
    edge = plot.side / 2 - plot.street - 0.5
    if plot.rng.random() < 0.6:
        plot.hedge(plot.x, plot.y + edge, 0.0, 2 * edge)
    if plot.rng.random() < 0.3:
        plot.wall(plot.x + edge, plot.y, 90.0, 2 * edge)
    plot.street_cars(0.25)


def forest_block(plot: Plot) -> None:
    """Place a closed wood or, sometimes, a clearing."""
    if plot.rng.random() < 0.12:
        plot.undergrowth(plot.rng.uniform(0.2, 0.8), plot.rng.uniform(0.3, 1.0))
        plot.bushes(3, 8, (0.4, 1.6))
    else:
        plot.wood(plot.rng.uniform(4.0, 6.0), (8.0, 26.0), plot.rng.choice([0.1, 0.5, 0.95]))


def mountain_block(plot: Plot) -> None:
    """Place wood or scrub on slopes, and houses with gardens in the valley."""
    slope = plot.slope(15.0)
    if slope > 0.3:
        share = 0.25
        if slope < 0.8:
            share = 0.6
        if plot.rng.random() < share:
            plot.wood(6.0, (5.0, 18.0), 0.6)
        else:
            plot.bushes(2, 12, (0.3, 1.2))
    else:
        suburb_block(plot)


def terrace_block(plot: Plot) -> None:
    """Place rows of vines or a house, with trees and bushes, a dugout and a wall."""
    if plot.rng.random() < 0.5:
        for off in np.arange(-plot.side / 2 + 2, plot.side / 2, 3.0):
            plot.hedge(plot.x, plot.y + float(off), 0.0, plot.side - 6.0)
    elif plot.rng.random() < 0.4:
        plot.house(*plot.pick(12.0), 0.0)
    if plot.rng.random() < 0.3:
        plot.dugout(*plot.pick(8.0))
    plot.trees(0, 5, (3.0, 9.0))
    plot.bushes(1, 6)
    if plot.rng.random() < 0.3:
        plot.wall(plot.x, plot.y - plot.side / 2 + 1.0, 0.0, 0.7 * plot.side)


def works_block(plot: Plot) -> None:
    """Place a hall with parked cars, bushes, a wood or low plants."""
    kind = plot.rng.random()
    if kind < 0.25:
        plot.hall(plot.rng.uniform(18, 32), plot.rng.uniform(10, 18))
        plot.street_cars(0.3)
    elif kind < 0.5 or plot.slope() > 0.3:
        plot.bushes(3, 10, (0.2, 1.5))
        plot.trees(0, 4)
    elif kind < 0.7:
        plot.wood(5.0, (5.0, 14.0), 0.1)
    else:
        plot.undergrowth(plot.rng.uniform(0.2, 0.6), plot.rng.uniform(0.2, 0.6))


def hall_block(plot: Plot) -> None:
    """Place a large hall, courtyard or podium, or else parking, with trees and bushes."""
    kind = plot.rng.random()
    if kind < 0.4:
        built = plot.hall(plot.rng.uniform(55, 95), plot.rng.uniform(35, 65))
    elif kind < 0.65:
        built = plot.courtyard(plot.rng.uniform(14, 20), closed=True)
    else:
        built = plot.podium()
    if not built:
        plot.parking()
    plot.trees(3, 10, (5.0, 12.0))
    plot.bushes(3, 9)
    plot.street_cars(0.4)


def mixed_block(plot: Plot) -> None:
    """Place houses, a wood or a field."""
    kind = plot.rng.random()
    if kind < 0.45:
        suburb_block(plot)
    elif kind < 0.65:
        plot.wood(5.5, (7.0, 22.0), 0.4)
    else:
        plot.undergrowth(plot.rng.uniform(0.2, 0.8), plot.rng.uniform(0.15, 0.9))
        plot.trees(0, 2)


def river_block(plot: Plot) -> None:
    """Place houses or flats on dry land, and trees and reed on the bank."""
    if plot.terrain.wet_at(plot.x, plot.y) or plot.slope() > 0.12:
        plot.trees(3, 9, (4.0, 14.0))
        plot.bushes(4, 12, (0.4, 1.6))
    elif plot.rng.random() < 0.3:
        plot.flats(plot.x, plot.y, 0.0)
        plot.trees(2, 5)
        plot.street_cars(0.3)
    else:
        suburb_block(plot)


def park_block(plot: Plot) -> None:
    """Place a wood, a meadow, or trees with beds and sometimes a kiosk, and some hedges."""
    kind = plot.rng.random()
    if kind < 0.18:
        plot.wood(6.5, (6.0, 20.0), 0.2)
    elif kind < 0.4:
        plot.undergrowth(plot.rng.uniform(0.5, 0.95), plot.rng.uniform(0.2, 0.7))
        plot.trees(1, 4)
    else:
        plot.trees(2, 7, (4.0, 18.0))
        plot.bushes(2, 6, (0.3, 2.0))
        if plot.rng.random() < 0.3:
            plot.house(plot.x, plot.y, float(plot.rng.uniform(0, 180)))
    if plot.rng.random() < 0.3:
        plot.hedge(plot.x, plot.y + 8.0, float(plot.rng.uniform(0, 180)), 18.0)


def row_block(plot: Plot) -> None:
    """Place two rows of terraced houses with gardens, or a small green, and parked cars."""
    length = plot.side - 2 * plot.street
    if plot.rng.random() < 0.15 or not plot.terrace(
        plot.x, plot.y - plot.side / 4 - 2.0, 0.0, length, 9.0
    ):
        plot.trees(4, 9, (5.0, 14.0))
        plot.bushes(2, 6)
    else:
        plot.terrace(plot.x, plot.y + plot.side / 4 + 6.0, 0.0, length, 9.0)
        plot.trees(2, 6, (4.0, 10.0))
        plot.bushes(3, 8, (0.4, 1.6))
    plot.street_cars(0.4)


def industry_block(plot: Plot) -> None:
    """Place a hall of about 90 x 50 m, a yard of trailers, or parking."""
    kind = plot.rng.random()
    if kind >= 0.65 or not plot.hall(plot.rng.uniform(80, 95), plot.rng.uniform(42, 55)):
        if kind < 0.9:
            plot.trailers()
        else:
            plot.parking()
    plot.trees(0, 4)
    plot.bushes(1, 4)


def bluff_block(plot: Plot) -> None:
    """Place a closed wood of 16 to 20 m on steep land, and a meadow or a house elsewhere."""
    if plot.slope() > 0.2:
        plot.wood(6.5, (16.0, 20.0), 0.5)
    elif plot.rng.random() < 0.15:
        plot.house(*plot.pick(8.0), float(plot.rng.uniform(0, 180)))
        plot.trees(1, 4)
    else:
        plot.undergrowth(plot.rng.uniform(0.3, 0.9), plot.rng.uniform(0.1, 0.25))


SPAN_M = 110.0
"""Distance of the towers of a power line, metres."""


def bridge(terrain: Terrain, line: Line, length: float, width: float) -> Objects:
    """Return a deck with parapets along a line, centred at the line's point. Lengths are metres.

    The deck connects the heights of the terrain at its two ends, so that a road has no step.
    """
    start, end = (
        float(terrain.height_at(*line.at(along))) for along in (-length / 2, length / 2)
    )
    top, tilt = (start + end) / 2, (end - start) / length
    base = top - 1.2
    deck = Solid(
        line.x, line.y, line.angle_deg, length, width, base, top, label=BRIDGE, tilt=tilt
    )
    parapet = replace(deck, width=0.3, top=top + 1.0)
    sides = []
    for across in (-width / 2, width / 2):
        x, y = line.at(0.0, across)
        sides.append(replace(parapet, x=x, y=y))
    return Objects(solids=(deck, *sides))


def power_line(terrain: Terrain, line: Line, length: float) -> Objects:
    """Return towers of 26 m every `SPAN_M`, with cross-arms and three sagging wires.

    The first tower is 0.15 `SPAN_M` after the line's point, and the last is less than
    ``length`` metres after it.
    """
    solids: list[Solid] = []
    wires: list[Wire] = []
    before: list[tuple[float, float, float]] = []
    for along in np.arange(0.15 * SPAN_M, length, SPAN_M):
        x, y = line.at(float(along))
        ground = float(terrain.height_at(x, y))
        arm = ground + 24.0
        solids.append(
            Solid(x, y, line.angle_deg, 1.2, 1.2, ground - 1.0, ground + 26.0, label=TOWER)
        )
        solids.append(Solid(x, y, line.angle_deg, 0.6, 12.0, arm, arm + 0.6, label=TOWER))
        ends = [(*line.at(float(along), across), arm) for across in (-6.0, 0.0, 6.0)]
        wires += [Wire(a, b, 4.0) for a, b in zip(before, ends, strict=False)]
        before = ends
    return Objects(solids=tuple(solids), wires=tuple(wires))
