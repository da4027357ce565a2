"""Remedies for mistakes in a command line: unknown options, those of other programs, and options given twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from difflib import get_close_matches

import click

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


def long_names(params: Sequence[click.Parameter]) -> list[str]:
    """Return the names of options that begin with two hyphens."""
    names = (name for p in params for name in (*p.opts, *p.secondary_opts))
    return [name for name in names if name.startswith("--")]


def abbreviations(
    arguments: Sequence[str], params: Sequence[click.Parameter]
) -> dict[str, str]:
    """Return the words that begin like exactly one option, with the name of this option.

    A name of `OTHER_PROGRAMS` is not an abbreviation, since its users expect what it means elsewhere.
    """
    names = long_names(params)
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


def unknown_option(error: click.NoSuchOption, arguments: Sequence[str]) -> str:
    """Return the message for an unknown option: what it is elsewhere, or the options that begin like it, or are close.

    Of ``-step``, click names only ``-s``. So the option is looked up in ``arguments``.
    """
    found = (a for a in arguments if a.startswith(error.option_name))
    given = next(found, error.option_name).partition("=")[0]
    word = _plain(given)
    if word in OTHER_PROGRAMS:
        return _ELSEWHERE.format(given) + OTHER_PROGRAMS[word]
    options = long_names(error.ctx.command.get_params(error.ctx)) if error.ctx else []
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
