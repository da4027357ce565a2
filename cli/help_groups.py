"""Groups of options in the help of commands with many options, and the short help of the frequent ones."""

from __future__ import annotations

from collections.abc import Sequence

import click

from cli.output import write_line

OWN_WORDS = "its own"
"""Short help of options that differ between commands: the first words of their help."""
GROUPS: dict[str, dict[str, str]] = {
    "Input": {
        "--crs": "CRS of files that have none",
        "--units": "units of the coordinates, such as ft",
        "--kind": "laser scan (als) or image matching (dim)",
        "--bounds": "process only a box",
        "--aoi": "process only the polygons of a file",
        "--salvage": "",
        "--on-error": "",
        "--verify": "",
    },
    "Output": {
        "--out": OWN_WORDS,
        "--products": "dtm, dsm, ndsm, hillshade, mask, contours, ...",
        "--resolution": "pixel size",
        "--sheets": "side of the sheets that products are cut into",
        "--sheet-name": "",
        "--product-name": "",
        "--empty-sheets": "",
        "--classified": "format of the classified clouds, or none",
        "--nodata": "",
        "--compress": "",
        "--contour-interval": "",
        "--contour-smooth": "",
    },
    "Ground": {
        "--preset": "settings for als, city, dim, forest, mountain, ...",
        "--method": "ground filter; keep uses the input's classes",
        "--set": "parameters of the method",
        "--ground-classes": "",
        "--sigma": "",
        "--statistics": "",
        "--tile-size": "",
        "--halo": "",
    },
    "Terrain": {
        "--max-edge": "longest edge of a facet that fills pixels",
        "--voids": "leave or fill holes in the DTM and DSM",
        "--breaklines": "lines that the terrain follows",
        "--edits": "polygons that correct the ground",
        "--bridges": "keep bridge decks in the terrain, or remove them",
        "--interpolation": "",
        "--surface": "",
        "--erode": "",
        "--canopy": "",
        "--outline": "",
        "--spike": "",
    },
    "Water": {
        "--water": "water bodies: auto, none or a file",
        "--water-low": "",
        "--water-min-lake": "",
        "--water-min-river-width": "",
        "--water-min-island": "",
    },
    "Points": {
        "--keep-classes": "classes that are not filtered",
        "--reclass": "classes that change in the classified clouds",
        "--drop-classes": "",
        "--withheld": "",
        "--returns": "",
        "--scan-angle": "",
        "--source-id": "",
        "--skip-synthetic": "",
        "--skip-overlap": "",
    },
    "Machine": {
        "--workers": "number of worker processes",
        "--memory": "memory limit of a worker",
        "--store": "path or URL of the tile store",
        "--scheduler": "",
        "--task-seconds": "",
        "--in-process": "",
        "--clean-store": "",
    },
    "Run": {
        "--config": "file with settings",
        "--overwrite": "start from the beginning",
        "--force": "replace files in OUT that the run did not write",
        "--json": "print the result as JSON",
        "--progress": "",
        "--verbose": "",
        "--quiet": "",
        "--help": "",
        "--help-all": "",
    },
}
"""Options by group. Frequent options have a short help."""
OWN = "Options"
"""Group of the options that only this command has. All of them are in the short help."""
MANY = 30
"""Number of options from which on the help of a command is short, and ``--help-all`` shows all."""

Rows = list[tuple[str, str]]


def write_options(
    context: click.Context,
    parameters: Sequence[click.Parameter],
    formatter: click.HelpFormatter,
) -> None:
    """Write the options of a command in groups: the frequent ones with short help, or all."""
    shows_all = context.meta.get(SHOWS_ALL, False)
    grouped: dict[str, Rows] = {name: [] for name in (OWN, *GROUPS)}
    for parameter in parameters:
        record = parameter.get_help_record(context)
        if record is None or not isinstance(parameter, click.Option):
            continue
        group, short = _place(parameter.opts)
        if short == OWN_WORDS:
            short = record[1].split(";")[0].split(" [")[0] + "  [required]" * parameter.required
        if shows_all:
            grouped[group].append(record)
        elif short:
            grouped[group].append((record[0].split(" [")[0].split(" / ")[0], short))
    for name, rows in grouped.items():
        if rows:
            with formatter.section(name):
                formatter.write_dl(rows, col_max=34 if shows_all else 26)
    if not shows_all:
        n_options = sum(isinstance(p, click.Option) for p in parameters)
        formatter.write_paragraph()
        formatter.write_text(
            f"`{context.command_path} --help-all` describes all {n_options} options."
        )


SHOWS_ALL = "tiler.help_all"
"""Key in `click.Context.meta`."""


def help_all_option() -> click.Option:
    """Return the option ``--help-all``."""

    def show(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
        if asked and not context.resilient_parsing:
            context.meta[SHOWS_ALL] = True
            for line in context.get_help().splitlines():
                write_line(line)
            context.exit()

    return click.Option(
        ["--help-all"],
        is_flag=True,
        expose_value=False,
        is_eager=True,
        callback=show,
        help="describe all options and exit [default: no]",
    )


def _place(names: Sequence[str]) -> tuple[str, str]:
    """Return the group and the short help of an option."""
    for group, options in GROUPS.items():
        for name in names:
            if name in options:
                return group, options[name]
    return OWN, OWN_WORDS
