"""Help of commands with many options, in groups, and remedies for mistakes in a command line.

The short help has the frequent options. Mistakes are unknown options, those of other programs, and options given twice.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from difflib import get_close_matches

import click

from cli.output import write_lines

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
        "--sheets": "sides or polygons of the sheets of products",
        "--sheet-field": "",
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
        "--priority": "",
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
            write_lines(context.get_help().splitlines())
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


_CRS = "the CRS of clouds without one is --crs EPSG:..."
_ELSEWHERE = "{} is an option of another program; here "
OTHER_PROGRAMS = {
    "t-srs": "rasters keep the CRS of the clouds, and `gdalwarp -t_srs EPSG:... OUT/dtm.tif FILE.tif` reprojects one",
    "of": "rasters are GeoTIFFs, and `gdal_translate -of FORMAT OUT/dtm.tif FILE` converts one",
    **dict.fromkeys(("a-srs", "s-srs", "epsg"), _CRS),
    **dict.fromkeys(("tr", "step", "gsd", "cell-size"), "the side of a pixel is --resolution LENGTH"),
    **dict.fromkeys(("te", "spat", "bbox", "projwin", "keep-xy"), "a part of the clouds is --bounds X0 Y0 X1 Y1"),
    **dict.fromkeys(("cutline", "clip", "poly", "polygon"), "a part of the clouds is --aoi FILE"),
    **dict.fromkeys(("cores", "threads", "jobs", "j"), "the number of processes is --workers N"),
    **dict.fromkeys(("odir", "outdir", "output", "outfile"), "the folder of the results is -o OUT"),
    **dict.fromkeys(("a-nodata", "dstnodata"), "the value of pixels without a height is --nodata VALUE"),
    "buffer": "each tile reads the points around it, as far as --halo LENGTH",
    "co": "the compression is --compress NAME",
    "keep-class": "a terrain of classes of the input is --method keep --ground-classes N,N",
    "drop-class": "classes are left out by --drop-classes N,N",
}  # fmt: skip
"""What to use in place of options of GDAL, PDAL and LAStools, by their names without leading hyphens, with hyphens for
underscores."""


def _long_names(params: Sequence[click.Parameter]) -> list[str]:
    names = (name for p in params for name in (*p.opts, *p.secondary_opts))
    return [name for name in names if name.startswith("--")]


def abbreviations(
    arguments: Sequence[str], params: Sequence[click.Parameter]
) -> dict[str, str]:
    """Return the words that begin like exactly one option, with the name of this option.

    A name of `OTHER_PROGRAMS` is not an abbreviation, since its users expect what it means elsewhere.
    """
    names = _long_names(params)
    words = {a.partition("=")[0] for a in arguments if a.startswith("--") and len(a) > 2}
    found = {}
    for word in words - {*names}:
        near = [name for name in names if name.startswith(word)]
        if len(near) == 1 and _plain(word) not in OTHER_PROGRAMS:
            found[word] = near[0]
    return found


def _plain(option: str) -> str:
    """Return the name of an option as in `OTHER_PROGRAMS`."""
    return option.lstrip("-").replace("_", "-").lower()


def options_in(text: str) -> set[str]:
    """Return the options that a text names outside of its commands of other programs, which are in backticks."""
    return set(re.findall(r"(?<![\w`])--?[a-z-]+", re.sub("`.*`", "", text)))


def unknown_option(error: click.NoSuchOption, arguments: Sequence[str]) -> str:
    """Return the message for an unknown option: what it is elsewhere, or the options that begin like it, or are close.

    A remedy is only given if the command has the options in it.

    Of ``-step``, click names only ``-s``. So the option is looked up in ``arguments``.
    """
    found = (a for a in arguments if a.startswith(error.option_name))
    given = next(found, error.option_name).partition("=")[0]
    word = _plain(given)
    params = error.ctx.command.get_params(error.ctx) if error.ctx else []
    own = {name for p in params for name in (*p.opts, *p.secondary_opts)}
    if word in OTHER_PROGRAMS and options_in(OTHER_PROGRAMS[word]) <= own:
        return _ELSEWHERE.format(given) + OTHER_PROGRAMS[word]
    options = _long_names(params)
    several = [name for name in options if name.startswith(f"--{word}")]
    if len(several) > 1:
        return f"{given} is the beginning of {' and '.join(several)}; write one of them"
    near = several or get_close_matches(f"--{word}", options)
    return f"there is no option {given}" + (
        f"; did you mean {' or '.join(near)}?" if near else ""
    )


def repeated_options(given: Sequence[click.Parameter]) -> list[str]:
    """Return the names of options that were given several times although only the last value counts."""
    counts = Counter(
        p
        for p in given
        if isinstance(p, click.Option) and not (p.multiple or p.count or p.is_flag)
    )
    return [option.opts[0] for option, n in counts.items() if n > 1]
