"""Results of a check and of an evaluation, as ``tiler check --json`` and ``tiler evaluate --json`` print them.

Those of a check are also the summary of a `tiler.CheckResult`.

A key that is NotRequired exists only if its value was measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NotRequired, TypedDict

from tiler.apps.difference_statistics import Spread


class InUnit(TypedDict):
    """Lengths of one unit, which has a name, and metres."""

    unit: str
    metres_per_unit: float


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


class Accuracy(InUnit):
    """Accuracy of a DTM, with heights in ``unit``.

    ``points``, ``used``, ``outside`` (of the raster) and ``no_height`` (a pixel around it has no data) are numbers of
    checkpoints. ``points_rmse`` is the checkpoints' own error. ``constant_offset`` is a sentence about a shift of all
    heights, or None.
    """

    dtm: str
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


class Seams(InUnit):
    """Steps within tiles (``interior``), across the edges of tiles and blocks, and on lines next to these edges.

    The heights are in ``unit``, and the sides of tiles and buckets in units of the CRS.
    ``excess`` is the mean jump across edges of tiles minus the mean jump next to them, or
    within tiles if the tiles are too small for lines next to edges.
    ``excess_error`` is its standard error as if pairs were independent, None for fewer than two.
    """

    horizontal_metres_per_unit: float
    tile: float
    bucket: float
    interior: Steps
    tiles: Steps
    blocks: NotRequired[Steps]
    beside_tiles: Steps
    beside_blocks: NotRequired[Steps]
    excess: float | None
    excess_error: float | None


class StripPair(Spread):
    """Source ids of two strips, their number of common cells, and the differences of second minus first."""

    first: int
    second: int
    cells: int


class Strips(InUnit):
    """Differences of all pairs of strips in the cells that they share, with heights in ``unit``.

    ``strips`` is the number of ground points by source id. ``cells`` is the number of comparisons, one per cell and
    pair of strips. ``rough`` is the number of comparisons left out, because a strip has too few points or is too rough.
    """

    cell_m: float
    strips: dict[str, int]
    cells: int
    rough: int
    all: Spread
    pairs: list[StripPair]


class ChangeFigures(Spread):
    """Number of pixels, and statistics of their changes."""

    pixels: int


class ChangePlace(TypedDict):
    """Changed pixels in connected cells: their bounds in units of the CRS, number and heights.

    ``largest_m`` is the largest absolute change. ``volume_m3`` is the sum of the absolute changes times the area of a
    pixel.
    """

    bounds: list[float]
    pixels: int
    area_m2: float
    mean_m: float
    largest_m: float
    volume_m3: float


class Against(InUnit):
    """Comparison with an earlier DTM: new minus old, in ``unit``, over the pixels that both have.

    ``only_new`` and ``only_old`` are numbers of pixels in which only one has a height. ``changed_pixels`` differ by
    ``change_m`` or more. ``by_source`` has a key per source of the new height (`mask.tif`), if it is known. ``places``
    are the largest of ``number_of_places``, and ``scattered_pixels`` changed outside them. ``difference`` is the path
    of the raster of differences, or None. ``notes`` say what was assumed.
    """

    old: str
    change_m: float
    only_new: int
    only_old: int
    changed_pixels: int
    all: ChangeFigures
    by_slope: dict[str, ChangeFigures]
    by_source: dict[str, ChangeFigures]
    scattered_pixels: int
    places: list[ChangePlace]
    number_of_places: int
    difference: str | None
    notes: list[str]


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
    against: NotRequired[Against]


class CheckSummary(Measured):
    """Results of all checks, their comparison with requirements, and the paths of the drawings."""

    requirements: list[Judgement]
    figures: list[str]


class AcceptanceRow(TypedDict):
    """Row of the check of clouds.

    ``asked`` is a minimum, a maximum, or a list of the allowed values, as ``limit`` says, and None if the specification
    does not ask. ``found`` is None if it was not measured, with the reason in ``remark``. ``state`` is ``pass``,
    ``fail``, ``not asked`` or ``not measured``. ``where`` has files, swaths or places, the worst first.
    """

    name: str
    unit: str
    limit: str
    asked: float | list[str] | list[int] | None
    found: float | list[str] | list[int] | None
    state: str
    where: list[str]
    remark: str


class SwathPair(TypedDict):
    """Two swaths by their point source ids, and the differences of the second minus the first in metres.

    Of the cells that they share, ``cells`` were compared. ``different_surfaces`` of them do not count in the figures,
    which are None without a compared cell. ``x`` and ``y`` are the middle of the shared cells in units of the CRS.
    """

    first: int
    second: int
    shared_cells: int
    cells: int
    different_surfaces: int
    mean_m: float | None
    rms_m: float | None
    p95_m: float | None
    x: float
    y: float


class AcceptanceSummary(TypedDict):
    """Check of clouds: their paths and number of points, the specification, the side of the cells, and the rows.

    ``swath_pairs`` are all pairs of swaths that share cells, the largest mean difference first. ``difference`` is the
    path of the raster of differences of swaths, and ``style`` that of its style, None if they were not written.
    ``page`` is the path of the page, None if none was asked. ``met`` tells whether no row has the state ``fail`` or
    ``not measured``. ``notes`` say what was assumed.
    """

    clouds: list[str]
    points: int
    specification: str | None
    cell_m: float | None
    met: bool
    rows: list[AcceptanceRow]
    swath_pairs: list[SwathPair]
    difference: str | None
    style: str | None
    page: str | None
    notes: list[str]


class Scores(TypedDict):
    """Numbers of points, errors and agreement of labels.

    Fractions are None for a division by zero. ``object_taken`` is the number of points of
    objects that are labelled ground. ``kappa`` is that of Cohen, ``f1`` and ``iou`` (intersection over union) are those
    of ground, and ``mcc`` is the correlation coefficient of Matthews.
    `tiler.apps.evaluate.clouds` defines the errors.
    """

    points: int
    ignored: int
    ground_kept: int
    ground_lost: int
    object_taken: int
    object_kept: int
    type_1: float | None
    type_2: float | None
    total: float | None
    kappa: float | None
    f1: float | None
    iou: float | None
    mcc: float | None


class ClassScores(TypedDict):
    """Numbers of points of a reference class, and the share of wrong points, None for a class that is left out."""

    points: int
    labelled_ground: int
    wrong: int | None
    error: float | None


class LabelScores(Scores):
    """Scores of all points and by class, and the numbers of points that were left out, by class and as withheld."""

    ignore: list[int]
    left_out: dict[str, int]
    withheld: int
    classes: dict[str, ClassScores]


class Unmatched(TypedDict):
    """Numbers of points without a partner."""

    unmatched_reference: int
    unmatched_cloud: int


class Pairing(Unmatched):
    """How the points of two files were paired: by their ``order`` or by their ``coordinates``."""

    matched_by: str


class CloudScores(LabelScores, Pairing):
    """Scores of one cloud."""


class SceneScores(CloudScores):
    """Scores of a scene, and the paths of its maps."""

    name: str
    cloud: str
    reference: str
    maps: list[str]


class FilteredScene(SceneScores):
    """Scores of a scene, and the time of its filter."""

    seconds: float


class OverallScores(LabelScores, Unmatched):
    """Scores of the points of all scenes together, and mean errors over scenes of equal weight."""

    mean: dict[str, float | None]


class SceneReport(OverallScores):
    """Scores of all scenes together, and of each scene."""

    scenes: list[SceneScores]


class FilterReport(OverallScores):
    """Scores of all scenes together and of each scene, and the method and parameters of the filter."""

    scenes: list[FilteredScene]
    method: str
    parameters: Mapping[str, object]


class SigmaFigures(TypedDict):
    """Number of pixels, and root mean square of their errors and of their standard errors."""

    pixels: int
    rmse: float | None
    predicted_rmse: float | None


class SlopeFigures(SigmaFigures):
    """Figures of the pixels in a class of slope."""

    from_deg: int
    to_deg: int


class SigmaReport(SigmaFigures):
    """Comparison of standard errors with errors.

    ``within_1`` to ``within_3`` are the shares of errors within 1, 2 and 3 standard errors, which are 0.683, 0.954 and
    0.997 for normally distributed errors. ``in_first_tenth`` is the share of the sum of squared errors in the tenth of
    the pixels with the largest standard errors. ``area`` is the same share, averaged over all fractions of the pixels
    from 0 to 1 (0.5 in random order). ``area_at_best`` is this average for pixels sorted by their errors.
    """

    within_1: float | None
    within_2: float | None
    within_3: float | None
    by_slope: list[SlopeFigures]
    area: float | None
    area_at_best: float | None
    in_first_tenth: float | None


class SigmaScores(TypedDict):
    """Comparison of the DTM's standard errors with its errors, and the path of the raster of standard errors.

    Both are missing without such a raster.
    """

    sigma: NotRequired[SigmaReport]
    sigma_file: NotRequired[str]


class DtmScores(Spread, SigmaScores):
    """Differences of a DTM from a reference, in ``unit``.

    ``pixels`` is the number of common pixels. ``only_dtm`` and ``only_truth`` are the numbers of pixels in the
    reference's extent that are valid in only one raster. ``coverage`` is the share of the reference's valid pixels that
    are valid in the DTM, and ``quantile_step`` the accuracy of medians and percentiles.
    """

    unit: str
    pixels: int
    only_dtm: int
    only_truth: int
    coverage: float | None
    quantile_step: float
