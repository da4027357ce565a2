"""Results of an evaluation, as ``tiler evaluate --json`` prints them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NotRequired, TypedDict

from tiler.core.difference_statistics import Spread


class Scores(TypedDict):
    """Numbers of points, errors and agreement of labels.

    Fractions are None for a division by zero. ``object_taken`` is the number of points of
    objects that are labelled ground. ``kappa`` is that of Cohen, ``f1`` that of ground.
    `tiler.apps.evaluate.labels` defines the errors.
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
