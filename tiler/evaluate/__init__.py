"""Scores against the truth: labels of clouds, heights of a DTM, and maps of the errors.

`tiler.evaluate.labels` holds the definitions, `tiler.evaluate.clouds` pairs the points of two files,
`tiler.evaluate.scenes` does it for many files, `tiler.evaluate.heights` compares rasters.
"""

from tiler.evaluate.clouds import evaluate_files
from tiler.evaluate.heights import evaluate_dtm, files_of_raster, refuse_targets
from tiler.evaluate.labels import IGNORED, confusion, evaluate_labels, scores
from tiler.evaluate.scenes import MapRequest, Scene, evaluate_scenes, filter_and_evaluate, find_scenes

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
    "refuse_targets",
    "scores",
]
