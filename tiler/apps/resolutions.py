"""A run with several resolutions: a folder in OUT for each of them, which share the points and the filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from tiler.apps.page_file import validate_page, write_page
from tiler.config import AUTO_WATER, NO_WATER, RunConfig
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, FeetLength
from tiler.errors import ConfigError
from tiler.io.locations import is_url
from tiler.io.result_folder import REPORT, STORE, WATER, is_results, read_run
from tiler.observe.events import Listener, ignore_events
from tiler.pipeline import run
from tiler.report.resolutions import MAKER, resolutions_page
from tiler.runs.job import RunResult
from tiler.schedule import fork_server_running

DIGITS = 6
"""Maximum number of digits of a length in the name of a folder."""


def run_resolutions(
    inputs: Sequence[str],
    out: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
    until: str = "export",
) -> RunResult:
    """Make terrain from clouds as `tiler.pipeline.run` does, with one resolution or several.

    Each of several resolutions has a folder in ``out`` with the results of a run. They share the ground, the edits and
    the bodies of water, which are found with the finest resolution, so that the heights at one position agree. The
    classified clouds are in the folder of the finest only. The page ``report.html`` in ``out`` lists the folders. A run
    that ends before the stage ``export`` makes the finest only.

    Parameters
    ----------
    inputs, out, config, listener, until
        Arguments of `tiler.pipeline.run`.

    Returns
    -------
    RunResult
        Result of the finest resolution, with those of the others (`RunResult.others`).

    Raises
    ------
    ConfigError
        With several resolutions: ``out`` is a URL, has the results of a run with one resolution, or its report.html is
        another page.
    TilerError
        `tiler.pipeline.run` raises it.
    """
    config = config or RunConfig()
    if not isinstance(config.resolution, tuple):
        return run(inputs, out, config, listener, until)
    folders = {folder_name(pixel): pixel for pixel in config.resolution}
    target = Path(out, REPORT)
    _check(out, target, config, inputs)
    settings = config.updated(store=config.store or str(Path(out).resolve() / STORE))
    with fork_server_running():  # All runs share the imports of its children.
        (folder, pixel), *others = folders.items()
        first_settings = settings.updated(resolution=pixel, clean_store=False)
        first = run(inputs, Path(out, folder), first_settings, listener, until)
        if until != "export":
            return first
        known, finest, runs = (
            first.plan.inputs.sources,
            first.plan.grid.resolution,
            {folder: first},
        )
        settings = _following(settings, first)
        for folder, pixel in others:
            is_last = len(runs) + 1 == len(folders)
            own = settings.updated(resolution=pixel, clean_store=config.clean_store and is_last)
            runs[folder] = run(
                inputs, Path(out, folder), own, listener, known=known, finest=finest
            )
    summaries = {folder: result.summary for folder, result in runs.items()}
    write_page(target, resolutions_page(Path(out), summaries))
    return replace(
        first,
        exit_code=max(result.exit_code for result in runs.values()),
        did_nothing=all(result.did_nothing for result in runs.values()),
        others=tuple(runs.values())[1:],
    )


def _following(settings: RunConfig, first: RunResult) -> RunConfig:
    """Return the settings of the resolutions after the first one."""
    water = settings.water
    if water == AUTO_WATER:
        # A search with other pixels would find other shores and levels.
        water = first.files.get(WATER, NO_WATER) if first.summary.get("water") else NO_WATER
    return settings.updated(classified="none", overwrite=False, water=water)


def folder_name(pixel: Fraction) -> str:
    """Return the name of the folder of a resolution, such as ``0.5m`` or ``2ft``."""
    if isinstance(pixel, FeetLength):
        return f"{float(pixel / FOOT):.{DIGITS}g}ft"
    in_metres, in_survey_feet = (
        f"{float(pixel / unit):.{DIGITS}g}" for unit in (METRE, US_SURVEY_FOOT)
    )
    if Fraction(in_metres) != pixel and Fraction(in_survey_feet) * US_SURVEY_FOOT == pixel:
        return f"{in_survey_feet}ft"
    return f"{in_metres}m"


def _store_of(out: str | Path) -> str:
    configured = (read_run(str(out)) or {}).get("configuration", {}).get("store")
    return str(configured or Path(out, STORE))


def _check(out: str | Path, target: Path, config: RunConfig, inputs: Sequence[str]) -> None:
    """Raise ConfigError if the folders of several resolutions, or their page, cannot be in ``out``."""
    if is_url(str(out)):
        raise ConfigError(
            f"-o {out}: is a URL, where only one resolution can be written; give one --resolution, and --store for "
            "the next"
        )
    if is_results(str(out)):
        raise ConfigError(
            f"-o {out}: has the results of a run with one resolution; give another folder, and --store "
            f"{_store_of(out)} to use its points again"
        )
    if target.exists() and not config.force:
        validate_page(target, inputs, MAKER, "-o")
