"""``tiler qgis``."""

from __future__ import annotations

from pathlib import Path

import click

from cli.ending import DONE, USAGE
from cli.output import write_line
from cli.qgis import installation
from cli.session import TilerCommand


@click.group("qgis", invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> int:
    """Install the QGIS plugin, or write it as an archive.

    The plugin adds tiler to the Processing toolbox of QGIS 3.22 or newer: Run, Preview,
    Classify, Check, Apply edits.
    """
    if context.invoked_subcommand is None:
        for line in context.get_help().splitlines():
            write_line(line, error=True)
        return USAGE
    return DONE


@command.command("install", cls=TilerCommand)
@click.option(
    "--profile",
    default="default",
    metavar="NAME",
    help="name of the QGIS profile, as listed under Settings > User Profiles [default: default]",
)
def install(profile: str) -> None:
    """Put the plugin into a profile of QGIS.

    Replaces an earlier version of the plugin. If another folder has its name, the command ends
    with an error and does not change that folder. The plugin gets the path of this command and
    a list of its settings. Run this command again after an update of tiler.
    """
    folder = installation.install(profile)
    write_line(f"installed  {folder}")
    write_line(
        "next       start QGIS and tick tiler under Plugins > Manage and Install Plugins > Installed, or, for scripts:"
    )
    write_line("           qgis_process plugins enable tiler_qgis")
    write_line(
        "remove     with Uninstall Plugin in the same window, or by deleting that folder"
    )


@command.command("package", cls=TilerCommand)
@click.argument("target", metavar="FILE.zip", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--upload",
    is_flag=True,
    help="end with an error if an address is missing that the repository of QGIS plugins requires",
)
def package(target: Path, upload: bool) -> None:
    """Write the plugin as an archive.

    QGIS installs it under Plugins > Manage and Install Plugins > Install from ZIP. This plugin
    looks for tiler in PATH, unless the path is set under Settings > Options > Processing >
    Providers > tiler.
    """
    installation.package(target, upload)
    write_line(
        f"written  {target}; QGIS: Plugins > Manage and Install Plugins > Install from ZIP"
    )
