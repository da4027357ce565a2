"""``tiler check`` of a DTM or of clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cli.acceptance import print_acceptance
from cli.options import json_option
from cli.output import print_json, print_table, write_line
from cli.session import TilerCommand
from tiler.core.units import length_text
from tiler.core.words import counted
from tiler.errors import ConfigError

FIGURES = ("points", "rmse_v", "bias", "median", "nmad", "p95_abs", "max_abs", "outliers")
HEADINGS = (
    "",
    "points",
    "RMSEV",
    "mean",
    "median",
    "NMAD",
    "95 % within",
    "largest",
    "outliers",
)


@click.command("check", cls=TilerCommand)
@click.argument("paths", nargs=-1, required=True, metavar="DTM|CLOUD...")
@click.option(
    "--spec",
    metavar="NAME",
    help="specification that clouds must meet: usgs-ql0, usgs-ql1, usgs-ql2 or FILE.toml; exit code 5 if they do not "
    "[default: none]",
)
@click.option(
    "--points",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="checkpoints: CSV (x, y, z, type NVA or VVA, cover), GeoJSON or GeoPackage [default: none]",
)
@click.option(
    "--points-crs",
    metavar="CRS",
    help="CRS of x and y of the checkpoints [default: the CRS of FILE, else the CRS of the DTM]",
)
@click.option(
    "--points-unit",
    metavar="UNIT",
    help="unit of the heights of the checkpoints: m, ft, usft [default: the unit of the DTM]",
)
@click.option(
    "--points-rmse",
    metavar="LENGTH",
    default="0",
    help="RMSE of the checkpoint heights themselves [unit: m; default: 0]",
)
@click.option(
    "--tile-size",
    metavar="LENGTH",
    help="look for seams at multiples of this length [unit: m; default: the tile size in run.json next to DTM]",
)
@click.option(
    "--strips",
    multiple=True,
    metavar="CLOUD",
    type=click.Path(),
    help="compare the flight strips of classified clouds; repeatable [default: none]",
)
@click.option(
    "--require",
    multiple=True,
    metavar="NAME=VALUE",
    help="end with exit code 5 if a requirement is not met. VALUE is a maximum for rmse, mean, median, nmad, p95, max, "
    "seam and strips (m) and outliers, and a minimum for points. All except seam and strips are measured at the NVA "
    "checkpoints; repeatable [default: none]",
)
@click.option(
    "--figures",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="draw histogram.svg and map.svg of the checkpoints [default: none]",
)
@click.option(
    "--against",
    metavar="DTM",
    help="earlier DTM, or OUT folder of an earlier run, to compare with; its pixels may differ [default: none]",
)
@click.option(
    "--change",
    metavar="LENGTH",
    help="least difference to the earlier DTM that is a change [unit: m; default: 0.5]",
)
@click.option(
    "--difference",
    type=click.Path(path_type=Path),
    metavar="FILE.tif",
    help="write DTM minus earlier DTM on the pixels of DTM, or of clouds the largest difference of two swaths in each "
    "cell [unit: of the DTM, or m of clouds; default: none]",
)
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    metavar="FILE.html",
    help="write the check of clouds as a page [default: none]",
)
@click.option(
    "--sheets",
    type=click.Path(),
    metavar="FILE",
    help="polygons of the sheets that clouds must cover [default: none]",
)
@click.option(
    "--sheet-field",
    metavar="NAME",
    help="field of the polygons with the names of the sheets [default: their numbers]",
)
@json_option
@click.pass_context
def command(
    context: click.Context,
    /,
    paths: tuple[str, ...],
    spec: str | None,
    page: Path | None,
    sheets: str | None,
    sheet_field: str | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Check a DTM by checkpoints, or clouds by a specification.

    Of a DTM, accuracy, seams, strip alignment and changes are measured.

    A difference is the height of the DTM, interpolated bilinearly between pixel centres, minus
    the height of the checkpoint. In the ASPRS standards, Edition 2, accuracy is the RMSE of the
    non-vegetated checkpoints (NVA) including the error of the checkpoints themselves. A
    statement of accuracy needs at least 30 of these checkpoints, the type of every checkpoint,
    and --points-rmse. The RMSE of vegetated checkpoints (VVA) is reported, but has no limit.

    DTM is a raster, or the OUT folder of a run. For OUT, the results are also written to
    OUT/check.json and replace those of the last check, and OUT/report.html is updated.

    CLOUD is a LAS or LAZ file, a folder, a glob or a .vpc. Header, classes, flags, swaths and
    their differences, density, distribution, voids and duplicates of all clouds together are
    measured. With clouds only --spec, --difference, --page, --sheets, --sheet-field and --json
    have a meaning.
    """
    from tiler.api import check, check_clouds
    from tiler.apps.acceptance import are_clouds

    given = [
        f"--{name.replace('_', '-')}"
        for name in options
        if name != "difference"
        and context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    ]
    if are_clouds(paths):
        if given:
            raise ConfigError(
                f"{given[0]}: is for a DTM, {paths[0]} is a cloud; leave it out, or give a DTM"
            )
        accepted = check_clouds(
            paths,
            spec,
            difference=options["difference"],
            page=page,
            sheets=sheets,
            sheet_field=sheet_field,
        )
        if as_json:
            print_json(accepted.summary)
        else:
            print_acceptance(accepted.summary)
        return accepted.exit_code
    for_clouds = {"spec": spec, "page": page, "sheets": sheets, "sheet-field": sheet_field}
    for name, value in for_clouds.items():
        if value is not None:
            raise ConfigError(
                f"--{name} {value}: is for clouds, {paths[0]} is not one; leave it out, or give LAS or LAZ clouds"
            )
    result = check(paths[0], **options)
    if as_json:
        print_json(result.summary)
    else:
        _print_report(result.summary)
        if result.report is not None:
            write_line(f"report  {result.report}")
    return result.exit_code


def _print_report(report: Mapping[str, Any]) -> None:
    if "accuracy" in report:
        _print_accuracy(report["accuracy"])
    if "seams" in report:
        _print_seams(report["seams"])
    if "strips" in report:
        _print_strips(report["strips"])
    if "against" in report:
        _print_changes(report["against"])
    for requirement in report["requirements"]:
        unit = f" {requirement['unit']}".rstrip()
        value = (
            "not measured"
            if requirement["value"] is None
            else f"{requirement['value']:.4g}{unit}"
        )
        state = "met" if requirement["met"] else "NOT met"
        write_line(
            f"required {requirement['name']} {requirement['limit']:g}{unit}: {value}, {state}"
        )
    for path in report["figures"]:
        write_line(f"drawn   {path}")


def _print_accuracy(accuracy: Mapping[str, Any]) -> None:
    from tiler.report.accuracy import statement_text

    rows = [
        (name.upper(), *_figures(accuracy[name]))
        for name in ("nva", "vva", "all")
        if accuracy[name]["points"]
    ]
    rows += [(name, *_figures(figures)) for name, figures in accuracy["land_cover"].items()]
    print_table(f"DTM minus checkpoint, {accuracy['unit']}", HEADINGS, rows)
    outside, none = accuracy["outside"], accuracy["no_height"]
    if outside or none:
        write_line(f"without a DTM height: {outside} outside the DTM, {none} at nodata pixels")
    if accuracy["constant_offset"]:
        write_line(accuracy["constant_offset"])
    write_line(statement_text(accuracy["asprs"]))
    for note in accuracy["notes"]:
        write_line(f"note    {note}")


def _figures(figures: Mapping[str, Any]) -> tuple[str, ...]:
    texts = []
    for name in FIGURES:
        value = figures[name]
        if value is None or isinstance(value, int):
            texts.append("-" if value is None else str(value))
        else:
            texts.append(f"{value:+.3f}" if name in ("bias", "median") else f"{value:.3f}")
    return tuple(texts)


def _print_seams(seams: Mapping[str, Any]) -> None:
    from tiler.report.accuracy import seams_text

    keys = ("mean_step", "largest_step", "mean_jump", "largest_jump")
    rows = [
        (
            name.replace("_", " "),
            f"{seams[name]['pairs']:,}",
            *(_number(seams[name][key]) for key in keys),
        )
        for name in ("tiles", "beside_tiles", "blocks", "beside_blocks", "interior")
        if name in seams
    ]
    columns = ("position", "pairs", "mean step", "largest step", "mean jump", "largest jump")
    unit = seams["horizontal_metres_per_unit"]
    edges = f"across edges of tiles of {length_text(seams['tile'] * unit, unit)}"
    print_table(f"steps between pixels, {seams['unit']}, {edges}", columns, rows)
    write_line(seams_text(seams))


def _print_strips(strips: Mapping[str, Any]) -> None:
    if not strips["pairs"]:
        write_line(
            f"strips  none to compare: the points have {counted(len(strips['strips']), 'flight line')} (by point "
            "source id), and no cell has points of two"
        )
        return
    keys = ("rmse", "bias", "median", "nmad", "p95_abs")
    rows = [
        (f"{p['second']} - {p['first']}", f"{p['cells']:,}", *(_number(p[key]) for key in keys))
        for p in strips["pairs"]
    ]
    rows.append(("all", f"{strips['cells']:,}", *(_number(strips["all"][key]) for key in keys)))
    columns = ("strips", "cells", "RMSE", "mean", "median", "NMAD", "95 % within")
    print_table(f"strips in cells of {strips['cell_m']:g} m, {strips['unit']}", columns, rows)


def _print_changes(against: Mapping[str, Any]) -> None:
    from tiler.report.accuracy import CHANGE_HEADINGS, changes_text, groups_of, places_of

    keys = ("rmse", "bias", "median", "nmad", "p95_abs")
    rows = [
        (name, f"{found['pixels']:,}", *(_number(found[key]) for key in keys))
        for name, found in groups_of(against).items()
    ]
    columns = ("pixels of", "number", "RMSE", "mean", "median", "NMAD", "95 % within")
    print_table(f"DTM minus {against['old']}, {against['unit']}", columns, rows)
    write_line(changes_text(against))
    if against["places"]:
        print_table("largest places", CHANGE_HEADINGS, places_of(against, 5))
    for note in against["notes"]:
        write_line(f"note    {note}")
    if against["difference"]:
        write_line(f"wrote   {against['difference']}")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
