"""``tiler preview``."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from cli.ending import DONE, PARTIAL
from cli.options import SETTINGS, config_options, inputs_argument, json_option, read_config
from cli.output import print_json, write_line
from cli.session import TilerCommand, current_session, shown_progress
from cli.summary import percent_text

WITHOUT = (
    "products", "sheets", "sheet_field", "sheet_name", "product_name", "empty_sheets", "bounds", "aoi", "store",
    "scheduler", "workers", "in_process", "task_seconds", "compress", "nodata", "on_error", "verify", "overwrite",
    "force", "clean_store", "voids", "canopy",
)  # fmt: skip
"""Settings of a run that a preview does not have."""


@click.command("preview", cls=TilerCommand, progress=True, reads=True)
@inputs_argument
@click.option(
    "-o",
    "--out",
    default="preview.png",
    type=click.Path(),
    metavar="FILE.png",
    help="file of the picture, replaced if it exists [default: preview.png]",
)
@click.option(
    "--windows",
    default=3,
    type=click.IntRange(1, 12),
    metavar="N",
    help="largest number of windows [default: 3]",
)
@click.option(
    "--size",
    metavar="LENGTH",
    help="side of a window [unit: m; default: up to 200, less where clouds are dense]",
)
@config_options(only=[name for name in SETTINGS if name not in WITHOUT])
@json_option
def command(
    inputs: tuple[str, ...],
    out: str,
    windows: int,
    size: str | None,
    as_json: bool,
    **settings: Any,
) -> int:
    """Draw a quick preview of the terrain for these settings.

    Processes a few windows of the clouds at full density as `tiler run` would with these
    settings. The picture has a column per window, with hillshades of the surface (above) and of
    the terrain (below). It shows which objects stay in the terrain, and which parts of the
    ground are missing.
    """
    config = read_config(settings)
    from tiler.apps.preview import make_preview
    from tiler.core.units import parse_length
    from tiler.errors import ConfigError

    side = None if size is None else float(parse_length(size))
    if side is not None and side <= 0:
        raise ConfigError(f"--size {size}: must be above 0")
    with shown_progress() as listener:
        drawn_windows = make_preview(inputs, out, config, listener, number=windows, side_m=side)
    if as_json:
        print_json(
            {
                "picture": out,
                "windows": [dataclasses.asdict(window) for window in drawn_windows],
            }
        )
    elif not current_session().quiet:
        write_line(f"{out}: surface above, terrain below; from left to right:")
        for window in drawn_windows:
            x0, y0, x1, y1 = window.bounds
            share = percent_text(window.ground / window.points)
            write_line(
                f"  --bounds {x0:.0f} {y0:.0f} {x1:.0f} {y1:.0f}: {window.points:,} points, {share} ground"
            )
    return PARTIAL if any(window.failed for window in drawn_windows) else DONE
