"""Results of a check, which ``tiler check --json`` prints and `tiler.CheckResult` has as its summary.

A key that is NotRequired exists only if its value was measured.
"""

from __future__ import annotations

from typing import NotRequired, TypedDict

from tiler.core.difference_statistics import Spread


class AccuracyFigures(Spread):
    """Differences of some checkpoints: their number, their statistics, and the number of outliers.

    ``rmse_v`` is the RMSE with the checkpoints' own error.
    """

    points: int
    rmse_v: float | None
    outliers: int


class Statement(TypedDict):
    """Statement of the accuracy by a standard.

    ``least_points`` is the number of NVA checkpoints that the standard requires. ``missing`` lists what the statement
    lacks. If it is not empty, ``statement`` is None.
    """

    standard: str
    least_points: int
    enough_points: bool
    missing: list[str]
    statement: str | None


class CheckedPoint(TypedDict):
    """Checkpoint in the CRS of the DTM, with heights in the unit of the DTM.

    ``dtm`` is the height of the DTM at the checkpoint, and ``difference`` is this height minus ``z``. Both are None if
    the DTM has no height there. ``kind`` is ``NVA`` or ``VVA``. ``cover`` is the land cover, or empty if not known.
    """

    name: str
    x: float
    y: float
    kind: str
    cover: str
    z: float
    dtm: float | None
    difference: float | None
    outlier: bool


class Accuracy(TypedDict):
    """Accuracy of a DTM, with heights in ``unit``.

    ``points``, ``used``, ``outside`` (of the raster) and ``no_height`` (a pixel around it has no data) are numbers of
    checkpoints. ``points_rmse`` is the checkpoints' own error. ``constant_offset`` is a sentence about a shift of all
    heights, or None.
    """

    dtm: str
    unit: str
    metres_per_unit: float
    points: int
    used: int
    outside: int
    no_height: int
    points_rmse: float
    all: AccuracyFigures
    nva: AccuracyFigures
    vva: AccuracyFigures
    land_cover: dict[str, AccuracyFigures]
    constant_offset: str | None
    asprs: Statement
    differences: list[CheckedPoint]
    notes: list[str]


class Steps(TypedDict):
    """Number of pairs of pixels, and their steps and jumps in units of the heights, None without a pair."""

    pairs: int
    mean_step: float | None
    largest_step: float | None
    mean_jump: float | None
    largest_jump: float | None


class Seams(TypedDict):
    """Steps within tiles (``interior``), across the edges of tiles and blocks, and on lines next to these edges.

    The heights are in ``unit``, and the sides of tiles and buckets in units of the CRS.
    ``excess`` is the mean jump across edges of tiles minus the mean jump next to them, or
    within tiles if the tiles are too small for lines next to edges.
    """

    unit: str
    metres_per_unit: float
    horizontal_metres_per_unit: float
    tile: float
    bucket: float
    interior: Steps
    tiles: Steps
    blocks: NotRequired[Steps]
    beside_tiles: Steps
    beside_blocks: NotRequired[Steps]
    excess: float | None


class StripPair(Spread):
    """Source ids of two strips, their number of common cells, and the differences of second minus first."""

    first: int
    second: int
    cells: int


class ComparedStrips(TypedDict):
    """Differences of all pairs of strips in the cells that they share.

    ``cells`` is the number of comparisons, one per cell and pair of strips. ``rough`` is the number of comparisons left
    out, because a strip has too few points or is too rough.
    """

    cells: int
    rough: int
    all: Spread
    pairs: list[StripPair]


class Strips(ComparedStrips):
    """Differences of strips, with heights in ``unit``, and the number of ground points by source id."""

    unit: str
    metres_per_unit: float
    cell_m: float
    strips: dict[str, int]


class Judgement(TypedDict):
    """Comparison of a value with its limit, both in ``unit``: ``m``, or empty for numbers of points.

    A requirement whose value was not measured (None) is not met.
    """

    name: str
    limit: float
    value: float | None
    unit: str
    met: bool


class Measured(TypedDict):
    """Path of a DTM, and the results of its checks."""

    dtm: str
    accuracy: NotRequired[Accuracy]
    seams: NotRequired[Seams]
    strips: NotRequired[Strips]


class CheckSummary(Measured):
    """Results of all checks, their comparison with requirements, and the paths of the drawings."""

    requirements: list[Judgement]
    figures: list[str]
