"""``tiler evaluate``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from cli.options import config_options, json_option, read_config
from cli.output import print_json, print_table, write_lines
from cli.session import TilerCommand, shown_progress
from cli.summary import AGREEMENT, dtm_lines, percent_text, score_lines
from tiler.config.parsing import parse_classes
from tiler.core.units import parse_length
from tiler.errors import ConfigError

SETTINGS = (
    "method",
    "parameters",
    "sigma",
    "kind",
    "units",
    "tile_size",
    "halo",
    "memory",
    "workers",
)


@click.command("evaluate", cls=TilerCommand, progress=True, reads=True)
@click.argument("clouds", metavar="[CLOUD]...", nargs=-1, type=click.Path())
@click.option(
    "--reference",
    "references",
    multiple=True,
    metavar="REF",
    type=click.Path(),
    help="cloud, folder or glob with the reference classes of the same points; repeatable [default: CLOUD itself, "
    "which --method then filters]",
)
@click.option(
    "--ignore",
    metavar="N,N,...",
    help="reference classes to ignore, or `none` [default: 7,9,17,18,26,64,65,66,67: noise, water, bridges, "
    "virtual points]",
)
@click.option(
    "--maps",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="write a map of the errors of each cloud as GeoTIFF and PNG [default: none]",
)
@click.option(
    "--map-cell",
    default="1",
    metavar="LENGTH",
    help="cell size of the maps [unit: m; default: 1]",
)
@click.option("--dtm", type=click.Path(), metavar="DTM", help="DTM to score [default: none]")
@click.option(
    "--true-dtm",
    type=click.Path(),
    metavar="RASTER",
    help="reference heights on the same pixels [default: none]",
)
@click.option(
    "--dtm-sigma",
    type=click.Path(),
    metavar="RASTER",
    help="standard errors of the DTM to score as well [default: sigma.tif next to dtm.tif, if it exists]",
)
@click.option(
    "--difference",
    type=click.Path(path_type=Path),
    metavar="FILE.tif",
    help="write DTM minus reference DTM [default: none]",
)
@config_options(only=SETTINGS)
@json_option
def command(
    clouds: tuple[str, ...],
    references: tuple[str, ...],
    ignore: str | None,
    maps: Path | None,
    map_cell: str,
    dtm: str | None,
    true_dtm: str | None,
    dtm_sigma: str | None,
    difference: Path | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Score classes or a DTM against reference data.

    Class 2 is ground, every other class is not. The type I error is the share of ground points
    that were lost, type II the share of other points that were classified as ground, and total
    the share of all wrong points. Kappa is Cohen's kappa, F1 and IoU (intersection over union)
    are those of ground, and MCC is Matthews' correlation coefficient. With --method, the classes
    of each CLOUD are the reference: the cloud is filtered without them and scored against them.
    If a cloud already had classes of noise or water when it was filtered, and `--keep-classes
    none` was not given, its score is too good. Clouds and references are paired by name, or by
    order if you give as many clouds as references.
    """
    if (dtm is None) != (true_dtm is None):
        raise click.UsageError("--dtm and --true-dtm need each other; give both")
    if not clouds and dtm is None:
        raise click.UsageError("nothing to evaluate; give CLOUD, or --dtm and --true-dtm")
    for option, value in (("--difference", difference), ("--dtm-sigma", dtm_sigma)):
        if value is not None and dtm is None:
            raise click.UsageError(f"{option} needs --dtm and --true-dtm")
    filters = settings["method"] is not None
    if clouds and filters == bool(references):
        raise click.UsageError(
            "give either --reference REF, or --method NAME to filter clouds with reference classes"
        )
    from tiler.apps import evaluate
    from tiler.schedule import call_isolated, half_of_memory

    ignored = evaluate.IGNORED if ignore is None else parse_classes(ignore)
    if maps is not None or difference is not None:
        scenes = evaluate.find_scenes(clouds, references or clouds) if clouds else []
        read = [path for scene in scenes for path in (scene.cloud, scene.reference)]
        rasters = [raster for raster in (dtm, true_dtm, dtm_sigma) if raster is not None]
        evaluate.validate_targets(
            difference, maps, [scene.name for scene in scenes], read, rasters
        )
    scores: Mapping[str, Any] = {}
    if clouds:
        cell = parse_length(map_cell)
        if cell <= 0:
            raise ConfigError(f"--map-cell {map_cell}: must be above 0")
        request = None if maps is None else evaluate.MapRequest(maps, cell)
        with shown_progress() as listener:
            if references:
                pairs = evaluate.find_scenes(clouds, references)
                scores = evaluate.evaluate_scenes(pairs, ignored, request, listener)
            else:
                config = read_config(settings)
                scores = evaluate.filter_and_evaluate(
                    clouds, config, ignored, request, listener
                )
    if dtm is not None and true_dtm is not None:
        both, sigma = (
            (Path(dtm), Path(true_dtm)),
            dtm_sigma or evaluate.raster_beside(dtm, "sigma"),
        )
        dtm_scores = call_isolated(
            evaluate.evaluate_dtm,
            *both,
            difference,
            sigma,
            paths=both,
            memory_bytes=half_of_memory(),
        )
        scores = {**scores, "dtm": dtm_scores}
    if as_json:
        print_json(scores)
        return
    if clouds:
        _print_scores(scores)
    if dtm is not None:
        write_lines(dtm_lines(scores["dtm"]))


def _print_scores(scores: Mapping[str, Any]) -> None:
    write_lines(score_lines(scores))
    rows = [
        (code, f"{c['points']:,}", f"{c['labelled_ground']:,}", percent_text(c["error"]))
        for code, c in scores["classes"].items()
    ]
    print_table(
        "by reference class", ("class", "points", "classified as ground", "error"), rows
    )
    scenes = scores["scenes"]
    if len(scenes) > 1:
        names = ("type_1", "type_2", "total", *AGREEMENT)
        lines = [
            (s["name"], f"{s['points']:,}", *(percent_text(s[n]) for n in names))
            for s in scenes
        ]
        lines.append(("mean", "", *(percent_text(scores["mean"][n]) for n in names)))
        columns = ("scene", "points", "type I", "type II", "total", *AGREEMENT.values())
        print_table("by scene", columns, lines)
    write_lines(f"map     {path}" for scene in scenes for path in scene["maps"])
