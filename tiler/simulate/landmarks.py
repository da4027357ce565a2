"""Bridges and power lines, which extend across blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tiler.simulate.objects import BRIDGE, TOWER, Objects, Solid, Wire
from tiler.simulate.terrain import Line, Terrain

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
