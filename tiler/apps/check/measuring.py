"""All checks of one DTM. Child processes read the files, because a damaged file may crash them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.figures import validate_figure_files, write_figures
from tiler.apps.check.points import PointOptions, read_checkpoints
from tiler.apps.check.requirements import Requirement, judge
from tiler.apps.check.seams import seams_of
from tiler.apps.check.strips import strip_differences
from tiler.errors import ConfigError
from tiler.schedule import call_isolated, half_of_memory


def measure(
    dtm: Path,
    points: Path | None,
    options: PointOptions,
    tile_m: Fraction | None,
    strips: Sequence[str] = (),
    requirements: Sequence[Requirement] = (),
    figures: Path | None = None,
) -> dict[str, Any]:
    """Check a DTM by checkpoints, by its seams, and by overlapping strips, as far as these are given.

    Parameters
    ----------
    dtm, points : Path
        Raster, and file of checkpoints.
    options : PointOptions
    tile_m : Fraction or None
        Side of a tile, see `seams_of`.
    strips : sequence of str
        Classified clouds.
    requirements : sequence of Requirement
    figures : Path, optional
        Folder for drawings of the checkpoints.

    Returns
    -------
    dict
        ``dtm`` (path); ``accuracy``, ``seams`` and ``strips``, if measured; ``requirements`` (see `judge`); ``figures``
        (paths of the drawings).

    Raises
    ------
    TilerError
    """
    if figures is not None:
        if points is None:
            raise ConfigError("--figures draws checkpoints; give them with --points")
        validate_figure_files(figures, dtm, points, strips)
    read = [path for path in (dtm, points) if path is not None]
    report: dict[str, Any] = {"dtm": str(dtm)}
    report |= call_isolated(
        _accuracy_and_seams, dtm, points, options, tile_m, paths=read, memory_bytes=half_of_memory()
    )
    if strips:
        report["strips"] = strip_differences(strips)
    if len(report) == 1:
        raise ConfigError(
            f"{dtm}: nothing to check; give --points, --tile-size (there is no run.json beside it) or --strips"
        )
    report |= {"requirements": judge(requirements, report), "figures": []}
    if figures is not None:
        drawn = (figures, dtm, report["accuracy"])
        report["figures"] = call_isolated(write_figures, *drawn, paths=(dtm,), memory_bytes=half_of_memory())
    return report


def _accuracy_and_seams(
    dtm: Path, points: Path | None, options: PointOptions, tile_m: Fraction | None
) -> dict[str, dict[str, Any]]:
    measured = {}
    if points is not None:
        measured["accuracy"] = check_dtm(dtm, read_checkpoints(points), options)
    seams = seams_of(dtm, tile_m)
    if seams is not None:
        measured["seams"] = seams
    return measured
