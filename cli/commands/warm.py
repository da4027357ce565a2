"""``tiler warm``."""

from __future__ import annotations

from dataclasses import asdict

import click

from cli.options import json_option
from cli.output import print_json, write_line
from cli.session import TilerCommand


@click.command("warm", cls=TilerCommand)
@click.argument("methods", metavar="[METHOD]...", nargs=-1)
@json_option
def command(methods: tuple[str, ...], as_json: bool) -> None:
    """Compile the kernels of methods before their first run.

    Compiles the kernels of each METHOD (of `auto` if you give none) and of the rasters, on all
    cores. Without this command, the first run on a machine compiles the kernels that it needs
    while it reads the points. The machine code is stored in NUMBA_CACHE_DIR if that is set,
    else in the user's cache folder. A folder that other users can change is not used.
    """
    from tiler.apps.warm import warm

    warmed = warm(methods or ("auto",))
    if warmed.refused:
        write_line(f"tiler: warning: {warmed.refused}", error=True)
    if as_json:
        facts = asdict(warmed)
        del facts["refused"]
        print_json(facts)
        return
    write_line(f"compiled  {warmed.compiled} kernels, {warmed.kernels} are in {warmed.folder}")
