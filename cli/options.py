"""Command line options made from the settings of a run (`tiler.config.settings`): names, help, units, defaults."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

from tiler.config import RunConfig, load_config, merged_pairs
from tiler.errors import ConfigError

Command = TypeVar("Command", bound=Callable[..., Any])

SETTINGS = {spec.name: spec for spec in dataclasses.fields(RunConfig)}

_METAVARS = {
    "length": "LENGTH",
    "lengths": "LENGTH[,LENGTH]",
    "sheets": "LENGTH[xLENGTH]|FILE",
    "bytes": "SIZE",
    "classes": "N,N,...",
    "names": "NAME,...",
    "pairs": "NAME=VALUE",
    "product_names": "PRODUCT=NAME,...",
    "bounds": "X0 Y0 X1 Y1",
    "int": "N",
    "preset": "NAME",
    "nodata": "VALUE",
    "area": "AREA",
    "file": "FILE",
    "files": "FILE",
}

REPEATED = {"pairs": "the method's own", "files": "none", "names": "dtm"}
"""Default, in words, of each kind of setting that may be given several times."""


def config_options(only: Collection[str] | None = None) -> Callable[[Command], Command]:
    """Decorate a command with ``--config`` and an option for each setting, or only for the settings in ``only``.

    The command gets the options as keyword arguments, and passes them to `read_config`.
    """

    def decorate(command: Command) -> Command:
        for spec in reversed(SETTINGS.values()):
            if only is None or spec.name in only:
                command = _option(spec)(command)
        file_option = click.option(
            "--config",
            "config_file",
            type=click.Path(path_type=Path),
            metavar="FILE.toml",
            help="file with settings (see `tiler config --template`), which override the settings of --preset; options "
            "of the command line override both [default: none]",
        )
        return file_option(command)

    return decorate


def read_config(settings: Mapping[str, Any]) -> RunConfig:
    """Return the effective settings: defaults, then the preset, then the TOML file, then the given options.

    Parameters
    ----------
    settings : mapping
        Keyword arguments that the command got from `config_options`.

    Raises
    ------
    ConfigError
        The file cannot be read, or a setting is not valid.
    """
    file = settings.get("config_file")
    values = load_config(file) if file is not None else {}
    given = {k: v for k, v in settings.items() if k in SETTINGS and v is not None and v != ()}
    if "parameters" in given:
        # One parameter given as an option leaves the others of the file as they are.
        given["parameters"] = merged_pairs(values.get("parameters", {}), given["parameters"])
    try:  # Errors of settings that no option replaces name the file.
        RunConfig.parse({name: values[name] for name in values if name not in given})
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error
    return RunConfig.from_mapping(values | given)


def default_text(spec: dataclasses.Field[Any]) -> str:
    """Return the default of a setting as users write it, or an empty text if there is none or the data decide."""
    value = spec.default
    if value is None or value == ():
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ",".join(str(v) for v in value)
    return str(value)


def describe_setting(spec: dataclasses.Field[Any]) -> str:
    """Return help, unit and default of a setting in one line."""
    parts = [f"unit: {spec.metadata['unit']}"] if spec.metadata["unit"] else []
    text = default_text(spec)
    if text:
        parts.append(f"default: {text}")
    elif "default" not in spec.metadata["help"]:
        parts.append("default: none")
    help: str = spec.metadata["help"]
    return help + (f" [{'; '.join(parts)}]" if parts else "")


def _option(spec: dataclasses.Field[Any]) -> Callable[[Command], Command]:
    kind, name = spec.metadata["kind"], spec.name.replace("_", "-")
    help = describe_setting(spec)
    if kind == "flag":
        return click.option(f"--{name}/--no-{name}", spec.name, default=None, help=help)
    if kind in REPEATED:
        help = f"{help.split(' [')[0]}; repeatable [default: {REPEATED[kind]}]"
    forms: dict[str, dict[str, Any]] = {
        "pairs": {"multiple": True},
        "files": {"multiple": True},
        "names": {"multiple": True},
        "bounds": {"nargs": 4, "type": float},
        "int": {"type": int},
        "choice": {"type": click.Choice(spec.metadata["choices"])},
    }
    metavar = None if kind == "choice" else _METAVARS.get(kind, spec.name.upper())
    option = "--set" if kind == "pairs" else f"--{name}"
    return click.option(option, spec.name, metavar=metavar, help=help, **forms.get(kind, {}))


inputs_argument = click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
"""The argument INPUT..."""

out_option = click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(),
    metavar="OUT",
    help="folder of the results, or a URL (s3://...); another run with the same OUT resumes",
)

json_option = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="print the result as JSON to stdout [default: no, as text]",
)
