"""Scores against references: classes of clouds, heights of a DTM, and maps of the errors.

`tiler.apps.evaluate.labels` contains the definitions, `tiler.apps.evaluate.clouds` pairs the points of two files,
`tiler.apps.evaluate.scenes` pairs and scores many files, and `tiler.apps.evaluate.heights` compares rasters.
`tiler.apps.evaluate.results` has the types of the results.
"""

from tiler.apps.evaluate.clouds import evaluate_files
from tiler.apps.evaluate.heights import (
    evaluate_dtm,
    files_of_raster,
    sigma_beside,
    validate_targets,
)
from tiler.apps.evaluate.labels import IGNORED, confusion, evaluate_labels, scores
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
    "confusion",
    "evaluate_dtm",
    "evaluate_files",
    "evaluate_labels",
    "evaluate_scenes",
    "files_of_raster",
    "filter_and_evaluate",
    "find_scenes",
    "scores",
    "sigma_beside",
    "validate_targets",
]
