"""Level of a river along its line: robust levels at stations, a falling profile, and steps at dams.

A station uses pixels within half a spacing along the line: pixels of the water with returns,
and of both banks. Returns of the water give the level if they are smooth. Banks give it if no
station with smooth returns is near. The profile is the isotonic regression of the levels,
weighted by evidence, in the direction that fits better.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.water import Counts, Station, lengths_along, lifted_line, places_along

Floats = npt.NDArray[np.float64]

BANK_PERCENT = 10
"""The level of the water is estimated as this percentile of the heights of a bank."""
MIN_PIXELS = 5
"""Fewest heights of a bank, or of the water itself, from which a level is estimated."""
SMOOTH_M = 0.3
"""Largest interquartile range of the water's heights at which their median is the level."""
BANK_WEIGHT = 0.05
"""Weight of a pixel of a bank. A pixel of the water itself has weight 1."""
NEAR_STATIONS = 3
"""Banks are not used at stations up to this far from a station with returns of the water, in
stations."""
LEVEL_M = 0.1
"""Total fall below which a river is level: a tenth of a metre between its ends is within the
errors of both."""
STEP_M = 0.4
"""A fall between two stations is a step at one position if it is more than this and steeper
than `STEEPEST`."""
STEEPEST = 1 / 30
"""Steepest slope of water without a step."""


class Scale(NamedTuple):
    """Number of counts per metre, in plan and of heights."""

    xy: float = float(COUNTS_PER_UNIT)
    z: float = float(COUNTS_PER_UNIT)


MILLIMETRES = Scale()


class Profile(NamedTuple):
    """Line of a river with the height of the water, int64 (n, 3), and its stations, both in downstream order."""

    flow: Counts
    stations: tuple[Station, ...]


def profile_along(
    line: Floats, shore: Counts, water: Counts, spacing: float, scale: Scale = MILLIMETRES
) -> Profile:
    """Estimate the level of a river along its line. The level never rises downstream.

    Parameters
    ----------
    line : float64 (n, 2)
        Line of the river in absolute counts.
    shore, water : int64 (3, n)
        Positions and heights of the terrain next to the water, and of the water itself where it has returns.
    spacing : float
        Distance of stations in counts.
    scale : Scale
    """
    along, stations, weights = _stations(line, shore, water, spacing, scale)
    if not len(stations):
        level = bank_level(shore[2]) if shore.shape[1] else float(np.median(water[2]))
        return Profile(lifted_line(line, np.zeros(1), np.array([level])), ())
    levels = np.array([station.level for station in stations])
    fits = [
        scipy.optimize.isotonic_regression(levels, weights=weights, increasing=up).x
        for up in (False, True)
    ]
    errors = [float((weights * (fit - levels) ** 2).sum()) for fit in fits]
    downstream = errors[0] <= errors[1]
    fit = fits[0 if downstream else 1]
    if np.ptp(fit) < LEVEL_M * scale.z:
        fit = np.full_like(fit, _weighted_median(levels, weights))
    stations = [
        s._replace(level=round(float(level))) for s, level in zip(stations, fit, strict=True)
    ]
    distances, heights = _with_steps(along, fit, line, water, scale)
    flow = lifted_line(line, distances, heights)
    if downstream:
        return Profile(flow, tuple(stations))
    turned = tuple(s._replace(left=s.right, right=s.left) for s in reversed(stations))
    return Profile(flow[::-1].copy(), turned)


def bank_level(heights: npt.NDArray[np.int64]) -> float:
    """Return the water level below a bank."""
    return float(np.percentile(heights, BANK_PERCENT))


def water_level(heights: npt.NDArray[np.int64], scale: Scale) -> float | None:
    """Return the level of water from its own heights, or None if they are too few or not smooth.

    If heights differ by more than waves do, for example between strips flown at different water
    levels, the lower level counts.
    """
    if len(heights) < MIN_PIXELS:
        return None
    low, middle, high = np.percentile(heights, (25, 50, 75))
    if high - low > 2 * SMOOTH_M * scale.z:
        return None
    return float(low if high - low > SMOOTH_M * scale.z else middle)


def _stations(
    line: Floats, shore: Counts, water: Counts, spacing: float, scale: Scale
) -> tuple[Floats, list[Station], Floats]:
    """Return the stations to use: distances along the line in counts, stations, and weights."""
    import shapely

    shape = shapely.LineString(line)
    shore_along, water_along = (places_along(line, xyz[0], xyz[1]) for xyz in (shore, water))
    left = _left_of(line, shore, shore_along)
    distances = np.concatenate((shore_along, water_along))
    if not len(distances):
        return np.empty(0), [], np.empty(0)
    low, high = float(distances.min()), float(distances.max())
    steps = round((high - low) / spacing)
    along = np.linspace(low, high, steps + 1) if steps else np.array([(low + high) / 2])
    stations: list[Station | None] = []
    weights = np.zeros(len(along))
    for i, distance in enumerate(along):
        near = np.abs(shore_along - distance) <= spacing / 2
        water_heights = water[2][np.abs(water_along - distance) <= spacing / 2]
        banks = [shore[2][near & side] for side in (left, ~left)]
        x, y = shapely.get_coordinates(shape.interpolate(distance))[0]
        station, weights[i] = _station(round(x), round(y), water_heights, banks, scale)
        stations.append(station)
    keep = _decisive(stations)
    return (
        along[keep],
        [s for s, kept in zip(stations, keep, strict=True) if kept and s is not None],
        weights[keep],
    )


def _station(
    x: int, y: int, own: npt.NDArray[np.int64], banks: list[npt.NDArray[np.int64]], scale: Scale
) -> tuple[Station | None, float]:
    """Return a station and the weight of its level, or None and 0 without evidence."""
    levels = [round(bank_level(bank)) if len(bank) >= MIN_PIXELS else None for bank in banks]
    water_height = water_level(own, scale)
    known = [level for level in levels if level is not None]
    if water_height is not None:
        return Station(x, y, round(water_height), len(own), levels[0], levels[1]), float(
            len(own)
        )
    if known:
        return Station(x, y, min(known), 0, levels[0], levels[1]), BANK_WEIGHT * sum(
            map(len, banks)
        )
    return None, 0.0


def _decisive(found: list[Station | None]) -> npt.NDArray[np.bool_]:
    """Return a mask of the stations to use: stations with returns of the water, and others far from them."""
    has_returns = np.array([station is not None and station.seen > 0 for station in found])
    near = has_returns
    if has_returns.any():
        near = scipy.ndimage.binary_dilation(has_returns, iterations=NEAR_STATIONS)
    known = np.array([station is not None for station in found])
    return np.asarray(has_returns | (known & ~near))


def _left_of(line: Floats, xyz: Counts, along: Floats) -> npt.NDArray[np.bool_]:
    """Return a mask of the points to the left of a line. ``along`` is the distance of each point along the line."""
    lengths = lengths_along(line)
    segment = np.clip(np.searchsorted(lengths, along, side="right") - 1, 0, len(line) - 2)
    start, step = line[segment], line[segment + 1] - line[segment]
    return np.asarray(
        step[:, 0] * (xyz[1] - start[:, 1]) - step[:, 1] * (xyz[0] - start[:, 0]) > 0
    )


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, cumulative[-1] / 2)])


def _with_steps(
    along: Floats, levels: Floats, line: Floats, water: Counts, scale: Scale
) -> tuple[Floats, Floats]:
    """Return distances along the line and levels, with two of each where the water has a step."""
    import shapely

    distances, heights = [along[:1]], [levels[:1]]
    inside = shapely.line_locate_point(
        shapely.LineString(line), shapely.points(water[0], water[1])
    )
    for i in range(len(along) - 1):
        fall, length = (
            abs(levels[i + 1] - levels[i]) / scale.z,
            (along[i + 1] - along[i]) / scale.xy,
        )
        if fall > STEP_M and fall > STEEPEST * length:
            step = _step_at(along[i], along[i + 1], levels[i], levels[i + 1], inside, water[2])
            distances.append(np.array([step - 0.05 * scale.xy, step + 0.05 * scale.xy]))
            heights.append(levels[i : i + 2])
        distances.append(along[i + 1 : i + 2])
        heights.append(levels[i + 1 : i + 2])
    return np.concatenate(distances), np.concatenate(heights)


def _step_at(
    start: float,
    end: float,
    before: float,
    after: float,
    inside: Floats,
    z: npt.NDArray[np.int64],
) -> float:
    """Return the distance along the line at which the water's heights change from one level to the other."""
    here = np.flatnonzero((inside > start) & (inside < end))
    here = here[np.argsort(inside[here], kind="stable")]
    if not len(here):
        return (start + end) / 2
    is_before = np.abs(z[here] - before) <= np.abs(z[here] - after)
    wrong = np.concatenate(([0], np.cumsum(~is_before))) + np.concatenate(
        (np.cumsum(is_before[::-1])[::-1], [0])
    )
    cut = int(np.argmin(wrong))
    edges = np.concatenate(([start], inside[here], [end]))
    return float(edges[cut] + edges[cut + 1]) / 2
