"""Runs all checks of one DTM; a command hands it to a child process, as the files are foreign."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.points import PointOptions, read_checkpoints
from tiler.apps.check.seams import seams_of


def measure(
    dtm: Path, points: Path | None, options: PointOptions, tile_m: Fraction | None
) -> dict[str, dict[str, Any]]:
    """Return ``accuracy`` by the checkpoints of a file, and ``seams``, each where there is something to measure by.

    Parameters
    ----------
    dtm, points : Path
    options : PointOptions
    tile_m : Fraction or None
        As of `seams_of`.

    Raises
    ------
    TilerError
        As `check_dtm`, `read_checkpoints` and `seams_of`.
    """
    found: dict[str, dict[str, Any]] = {}
    if points is not None:
        found["accuracy"] = check_dtm(dtm, read_checkpoints(points), options)
    seams = seams_of(dtm, tile_m)
    return found if seams is None else {**found, "seams": seams}
