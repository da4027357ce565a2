"""``tiler config``."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from cli.options import SETTINGS, config_options, describe_setting, read_config
from cli.output import write_line, write_lines
from cli.session import TilerCommand
from tiler.config import RunConfig
from tiler.config.sources import preset_text
from tiler.errors import ConfigError
from tiler.redaction import without_secrets

HEAD = "# Settings of tiler for --config; options override them. A setting that is commented out has no value."
LAST = "parameters"  # a table, which must follow the plain values in TOML


@click.command("config", cls=TilerCommand)
@click.option(
    "--template",
    is_flag=True,
    help="print all settings with help, unit and default [default: no]",
)
@config_options()
def command(template: bool, **settings: Any) -> None:
    """Print the effective settings or a commented template.

    Prints as TOML the settings that a command with the same options (and --config FILE.toml)
    would use, with every parameter of the method. With --template it prints all settings and
    their meaning. With --preset NAME it prints the file of the preset first. Options override
    --config, --config overrides --preset, --preset overrides the defaults.
    """
    config = read_config(settings)
    if config.store is not None and config.store != without_secrets(config.store):
        write_line(
            "tiler: warning: store: written without the user, password and query of its URL, which tiler never prints",
            error=True,
        )
    lines = [HEAD]
    if name := config.preset:
        head = f"# The values of the preset {name} apply below, unless another setting overrides them. The preset:"
        lines += [
            "#",
            head,
            *(f"#   {line}".rstrip() for line in preset_text(name).splitlines()),
        ]
    lines.append("")
    for name in (n for n in SETTINGS if n != LAST):
        if template:
            lines.append(f"# {describe_setting(SETTINGS[name])}")
        value = config.to_json()[name]
        lines.append(f"# {name} =" if value is None else toml_line(name, value))
        if template:
            lines.append("")
    lines.extend(_parameter_lines(config, template))
    write_lines("\n".join(lines).split("\n"))


def toml_line(name: str, value: Any) -> str:
    """Return ``name = value`` in TOML on one line."""
    import tomli_w

    if isinstance(value, list):  # the library writes arrays over several lines
        items = (tomli_w.dumps({"v": v}).removeprefix("v = ").strip() for v in value)
        return f"{name} = [{', '.join(items)}]"
    return tomli_w.dumps({name: value}).strip()


def _parameter_lines(config: RunConfig, template: bool) -> list[str]:
    """Return the lines of the table with the effective value of each parameter of the method."""
    lines = (
        [f"# parameters of the method {config.method}; `tiler methods` explains them"]
        if template
        else [""]
    )
    lines.append("[parameters]")
    if config.method == "keep":
        return lines
    from ptd.methods import make_params

    try:
        params = make_params(config.method, dict(config.parameters))
    except ValueError as error:
        raise ConfigError(f"{error}; see `tiler methods`") from error
    for spec in dataclasses.fields(params):
        if template:
            unit = f" [unit: {spec.metadata['unit']}]" if spec.metadata["unit"] else ""
            lines.append(f"# {spec.metadata['help']}{unit}")
        # The template must not fix parameters for which a newer version or another method has
        # other values.
        mark = "# " if template else ""
        lines.append(mark + toml_line(spec.name, getattr(params, spec.name)))
    return lines
