"""Scores against references: classes of clouds, heights of a DTM, and maps of the errors.

`clouds` defines the scores of labels and pairs the points of two files, `scenes` does so for many files, and `maps`
draws their errors. `heights` compares rasters, which `rasters` opens and reads. `tiler.apps.results` has the types of
the results.
"""

from tiler.apps.evaluate.clouds import (
    IGNORED,
    evaluate_files,
    evaluate_labels,
    scores,
)
from tiler.apps.evaluate.heights import evaluate_dtm, validate_targets
from tiler.apps.evaluate.rasters import raster_beside
from tiler.apps.evaluate.scenes import (
    MapRequest,
    Scene,
    evaluate_scenes,
    filter_and_evaluate,
    find_scenes,
)

__all__ = [
    "IGNORED",
    "MapRequest",
    "Scene",
    "evaluate_dtm",
    "evaluate_files",
    "evaluate_labels",
    "evaluate_scenes",
    "filter_and_evaluate",
    "find_scenes",
    "raster_beside",
    "scores",
    "validate_targets",
]
