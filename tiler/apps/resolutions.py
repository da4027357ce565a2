"""A run with several resolutions: a folder in OUT for each of them, which share the points and the filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from tiler.config import AUTO_WATER, NO_WATER, RunConfig
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT
from tiler.errors import ConfigError, TilerError, write_error
from tiler.io.cloud_formats import SUFFIXES
from tiler.io.locations import is_url, local_or_url
from tiler.io.overwrite_check import check_names
from tiler.io.result_folder import REPORT, STORE, WATER, read_run, resolution_folders
from tiler.observe.events import Listener, Note, ignore_events
from tiler.observe.job_progress import OneOfSeveral, stages_of
from tiler.pipeline import expected_stages, run
from tiler.plan import Plan, make_plan
from tiler.report.document import is_page_of
from tiler.report.resolutions import MAKER, resolutions_page
from tiler.report.runfile import write_whole
from tiler.runs.job import RunResult
from tiler.schedule import fork_server_running

DIGITS = 6
"""Maximum number of digits of a length in the name of a folder."""
UNITS = {METRE: "m", FOOT: "ft", US_SURVEY_FOOT: "ft"}
"""Units in the names of folders. The name has the one in which the length is shortest, or else the first."""


def run_resolutions(
    inputs: Sequence[str],
    out: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
    until: str = "export",
) -> RunResult:
    """Make terrain from clouds as `tiler.pipeline.run` does, with one resolution or several.

    Each of several resolutions has a folder in ``out`` with the results of a run. All heights are on the surface of the
    finest one, which also finds the bodies of water and has the classified clouds. The page ``report.html`` in ``out``
    lists the folders. A run that ends before the stage ``export`` makes the finest only.

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
        A resolution cannot be made with the settings. Or ``out`` is a URL, has the results of a run with one
        resolution, or its report.html is another page.
    TilerError
        `tiler.pipeline.run` raises it.
    """
    config, out = config or RunConfig(), local_or_url(out)
    if not isinstance(config.resolution, tuple):
        _check_folder(out)
        return run(inputs, out, config, listener, until)
    with fork_server_running():  # All runs share the imports of its children.
        plans = plan_resolutions(inputs, config, out)
        _tell_of_others(out, plans, listener)
        _write_page(Path(out), plans, is_running=True)
        try:
            results = _run_all(inputs, Path(out), config, plans, listener, until)
        except BaseException:
            with suppress(TilerError):  # The error that ended the run is reported.
                _write_page(Path(out), plans)
            raise
    _write_page(Path(out), plans)
    return replace(
        results[0],
        exit_code=max(result.exit_code for result in results),
        did_nothing=all(result.did_nothing for result in results),
        others=tuple(results[1:]),
    )


def plan_resolutions(
    inputs: Sequence[str], config: RunConfig, out: str | Path | None = None
) -> dict[str, Plan]:
    """Return the plan of each resolution by the name of its folder, which is empty if there is only one.

    Parameters
    ----------
    inputs, config, out
        Arguments of `tiler.plan.make_plan`.

    Raises
    ------
    ConfigError, InputError
        `tiler.plan.make_plan` raises it for one of the resolutions, or ``out`` cannot be used for several.
    """
    out = None if out is None else local_or_url(out)
    if not isinstance(config.resolution, tuple):
        return {"": make_plan(inputs, config, out)}
    folders = {folder_name(pixel): pixel for pixel in config.resolution}
    if len(folders) < len(config.resolution):
        raise ConfigError(
            f"resolution: two lengths have the same {DIGITS} digits ({', '.join(folders)}); give one of them"
        )
    if out is not None:
        _check_out(out, config)
    plans: dict[str, Plan] = {}
    for folder, pixel in folders.items():
        first = next(iter(plans.values()), None)
        plans[folder] = make_plan(
            inputs,
            _settings(config, out, pixel, first is None),
            None if out is None else Path(out, folder),
            known=first.inputs.sources if first else (),
            finest=first.grid.resolution if first else None,
        )
    return plans


def _settings(
    config: RunConfig, out: str | Path | None, pixel: Fraction, is_first: bool
) -> RunConfig:
    """Return the settings of one of several resolutions."""
    store = config.store
    if store is None and out is not None:
        store = str(Path(out).resolve() / STORE)
    own = config.updated(resolution=pixel, store=store)
    return own if is_first else own.updated(classified="none", overwrite=False)


def _run_all(
    inputs: Sequence[str],
    out: Path,
    config: RunConfig,
    plans: Mapping[str, Plan],
    listener: Listener,
    until: str,
) -> list[RunResult]:
    results: list[RunResult] = []
    later = [
        stage
        for name in list(plans)[1:]
        for stage in stages_of(name, expected_stages(plans[name], until))
    ]
    known = next(iter(plans.values())).inputs.sources
    for folder, plan in plans.items():
        is_last = len(results) + 1 == len(plans) or until != "export"
        settings = plan.config.updated(clean_store=config.clean_store and is_last)
        finest = None
        if results:
            finest = results[0].plan.grid.resolution
            settings = settings.updated(water=_water(config, results[0]))
        told = OneOfSeveral(listener, folder if results else "", later, is_last)
        results.append(run(inputs, out / folder, settings, told, until, known, finest))
        if is_last:
            break
    return results


def _water(config: RunConfig, first: RunResult) -> str:
    """Return the setting `water` of the resolutions after the first one."""
    if config.water != AUTO_WATER:
        return config.water
    # A search with other pixels would find other shores and levels.
    return first.files.get(WATER, NO_WATER) if first.summary.get("water") else NO_WATER


def folder_name(pixel: Fraction) -> str:
    """Return the name of the folder of a resolution, such as ``0.5m`` or ``2ft``."""
    names = []
    for unit, name in UNITS.items():
        text = f"{float(pixel / unit):.{DIGITS}g}"
        if Fraction(text) * unit == pixel:
            names.append(f"{text}{name}")
    return min(names, key=len, default=f"{float(pixel):.{DIGITS}g}m")


def _check_folder(out: str | Path) -> None:
    if not is_url(str(out)) and str(Path(out)) in resolution_folders(Path(out).parent):
        whole = Path(out).parent
        raise ConfigError(
            f"-o {out}: is the folder of one of several resolutions; give -o {whole} with all of them (--resolution)"
        )


def _check_out(out: str | Path, config: RunConfig) -> None:
    """Raise ConfigError if the folders of several resolutions, or their page, cannot be in ``out``."""
    if not str(out):
        raise ConfigError("-o: has no name; give a folder for the results")
    if is_url(str(out)):
        raise ConfigError(
            f"-o {out}: is a URL, where only one resolution can be written; give one --resolution, and --store for "
            "the next"
        )
    check_names("-o", str(out))
    page = Path(out, REPORT)
    if Path(out).suffix.lower() in (*SUFFIXES, ".tif"):
        raise ConfigError(f"-o {out}: has the name of a file; give a folder")
    earlier = read_run(str(out)) or {}
    if earlier.get("outputs"):
        store = earlier["configuration"].get("store") or Path(out, STORE)
        raise ConfigError(
            f"-o {out}: has the results of a run with one resolution; give another folder, and --store {store} to use "
            "its points again"
        )
    if page.is_dir() or (page.exists() and not config.force and not is_page_of(page, MAKER)):
        raise ConfigError(
            f"-o {out}: {REPORT}: already exists and was not written by a run in this folder; use another -o, or "
            "--force to replace it"
        )


def _tell_of_others(out: str | Path, plans: Mapping[str, Plan], listener: Listener) -> None:
    others = [path for path in resolution_folders(out) if Path(path).name not in plans]
    if others:
        listener(Note(f"{', '.join(others)}: of an earlier run with other resolutions"))


def _write_page(out: Path, plans: Mapping[str, Plan], is_running: bool = False) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(str(out), error, out) from error
    runs = {folder: read_run(str(out / folder)) for folder in plans}
    write_whole(out / REPORT, resolutions_page(out, runs, is_running))
