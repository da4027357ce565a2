"""All checks of one DTM. Child processes read the files, because a damaged file may crash them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.figures import validate_figure_files, write_figures
from tiler.apps.check.points import PointOptions, read_checkpoints
from tiler.apps.check.requirements import Requirement, judge
from tiler.apps.check.results import Accuracy, CheckSummary, Measured, Seams
from tiler.apps.check.seams import seams_of
from tiler.apps.check.strips import strip_differences
from tiler.errors import ConfigError, InputError
from tiler.io.locations import joined, state_at
from tiler.io.result_folder import raster_places, read_run
from tiler.schedule import call_isolated, half_of_memory


def terrain_in(out: str) -> str:
    """Return the path or URL of the DTM in the results of a run, or raise InputError if there is none."""
    for name in raster_places(read_run(out), "dtm"):
        if state_at(joined(out, name)) is not None:
            return joined(out, name)
    raise InputError(f"{out}: contains no DTM; finish its run, or give the path of a DTM")


def measure(
    dtm: Path,
    points: Path | None,
    options: PointOptions,
    tile_m: Fraction | None,
    strips: Sequence[str] = (),
    requirements: Sequence[Requirement] = (),
    figures: Path | None = None,
) -> CheckSummary:
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

    Raises
    ------
    TilerError
    """
    if figures is not None:
        if points is None:
            raise ConfigError("--figures draws checkpoints; give them with --points")
        validate_figure_files(figures, dtm, points, strips)
    read = [path for path in (dtm, points) if path is not None]
    accuracy, seams = call_isolated(
        _accuracy_and_seams,
        dtm,
        points,
        options,
        tile_m,
        paths=read,
        memory_bytes=half_of_memory(),
    )
    measured: Measured = {"dtm": str(dtm)}
    if accuracy is not None:
        measured["accuracy"] = accuracy
    if seams is not None:
        measured["seams"] = seams
    if strips:
        measured["strips"] = strip_differences(strips)
    if len(measured) == 1:
        raise ConfigError(
            f"{dtm}: nothing to check; give --points, --tile-size (there is no run.json beside it) or --strips"
        )
    judgements = judge(requirements, measured)
    drawings: list[str] = []
    if figures is not None:
        drawings = call_isolated(
            write_figures, figures, dtm, accuracy, paths=(dtm,), memory_bytes=half_of_memory()
        )
    return {**measured, "requirements": judgements, "figures": drawings}


def _accuracy_and_seams(
    dtm: Path, points: Path | None, options: PointOptions, tile_m: Fraction | None
) -> tuple[Accuracy | None, Seams | None]:
    accuracy = None
    if points is not None:
        accuracy = check_dtm(dtm, read_checkpoints(points), options)
    return accuracy, seams_of(dtm, tile_m)
