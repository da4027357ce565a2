"""``tiler check`` of a DTM or of clouds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cli.options import json_option
from cli.output import print_json, write_line
from cli.session import TilerCommand
from tiler.errors import ConfigError


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
@click.option(
    "--workers",
    type=int,
    metavar="N",
    help="number of processes that read clouds [default: the cores of the machine, at most 8]",
)
@click.option(
    "--memory",
    metavar="SIZE",
    help="memory limit of each process that checks clouds [default: half of the machine's memory, divided among those "
    "that read clouds]",
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
    workers: int | None,
    memory: str | None,
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
    measured. With clouds only --spec, --difference, --page, --sheets, --sheet-field, --workers,
    --memory and --json have a meaning.
    """
    from cli.checks import print_acceptance, print_report
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
            workers=workers,
            memory=memory,
        )
        if as_json:
            print_json(accepted.summary)
        else:
            print_acceptance(accepted.summary)
        return accepted.exit_code
    for_clouds = {
        "spec": spec,
        "page": page,
        "sheets": sheets,
        "sheet-field": sheet_field,
        "workers": workers,
        "memory": memory,
    }
    for name, value in for_clouds.items():
        if value is not None:
            raise ConfigError(
                f"--{name} {value}: is for clouds, {paths[0]} is not one; leave it out, or give LAS or LAZ clouds"
            )
    result = check(paths[0], **options)
    if as_json:
        print_json(result.summary)
    else:
        print_report(result.summary)
        if result.report is not None:
            write_line(f"report  {result.report}")
    return result.exit_code
