"""Settings of the QGIS plugin, made from the commands: names, units, defaults, choices and help."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import click

from cli.main import COMMANDS
from cli.options import SETTINGS, default_text
from tiler.config import RunConfig
from tiler.core.products import PRODUCTS
from tiler.io.cloud_formats import SUFFIXES
from tiler.version import __version__

SHELLS = ("run", "preview", "classify", "check")
"""Commands that are algorithms of the plugin."""
NOT_IN_QGIS = {"as_json", "progress", "verbose", "quiet", "in_process", "spec"}
"""Options that QGIS sets itself, that are only for debugging, or for clouds, while its check is of a raster."""
PLACES = {
    "inputs": "INPUT",
    "source": "INPUT",
    "paths": "INPUT",
    "out": "OUTPUT",
    "target": "OUTPUT",
}
"""Names in QGIS of the parameters that are inputs or outputs of a command."""
KINDS = {("run", "out"): "new_folder", ("preview", "out"): "new_picture", ("classify", "target"): "new_cloud",
         ("run", "inputs"): "clouds", ("preview", "inputs"): "clouds", ("classify", "source"): "cloud",
         ("check", "paths"): "raster", ("check", "figures"): "new_plots"}  # fmt: skip
SHOWN_FIRST = {
    "preset", "method", "products", "resolution", "classified", "voids", "water", "bridges", "edits", "breaklines",
    "crs", "bounds", "aoi", "units", "windows", "size", "points", "points_crs", "require", "keep_classes",
    "reclass",
}  # fmt: skip
"""Settings that are not advanced parameters."""
OF_TYPE: dict[str, Callable[[Any], Any]] = {
    "flag": bool,
    "int": lambda value: value,
    "names": list,
}
"""Defaults of settings that the plugin gets as values, by kind. It gets the others as text."""
_CONFIG_DEFAULTS = RunConfig().to_json()
LABELS = {
    "INPUT": "Point clouds", "OUTPUT": "Folder of the results", "CONFIG": "File with settings (TOML)",
    "AOI": "Area (polygons)", "SET": "Parameters of the method (name=value)", "CRS": "CRS of clouds that have none",
    "BOUNDS": "Extent", "POINTS": "Checkpoints", "POINTS_CRS": "CRS of the checkpoints",
    "POINTS_UNIT": "Unit of the checkpoints' heights", "POINTS_RMSE": "RMSE of the checkpoints' heights",
    "REQUIRE": "Required (name=value)", "FIGURES": "Folder for plots", "KIND": "Source of the cloud",
    "STRIPS": "Classified clouds whose flight strips are compared", "HALO": "Halo of a tile",
    "WATER_MIN_LAKE": "Smallest lake", "WATER_MIN_RIVER_WIDTH": "Smallest river (width)",
    "WATER_MIN_ISLAND": "Smallest island", "SIGMA": "Noise of heights (standard deviation)",
    "RECLASS": "Classes that change",
}  # fmt: skip
LABELS_OF = {
    "preview": {
        "OUTPUT": "Picture",
        "SIZE": "Side of a window",
        "WINDOWS": "Largest number of windows",
    },
    "classify": {"INPUT": "Point cloud", "OUTPUT": "Classified cloud"},
    "check": {"INPUT": "Terrain model"},
}
_PATTERNS = (f"*{suffix}" for suffix in (*SUFFIXES, ".vpc", *map(str.upper, SUFFIXES), ".json"))
CLOUD_FILES = f"Point clouds ({' '.join(_PATTERNS)});;All files (*)"


def table() -> dict[str, Any]:
    """Return the settings of this version for the plugin, as a JSON-able value."""
    return {
        "version": __version__,
        "cloud_files": CLOUD_FILES,
        "products": list(PRODUCTS),
        "mask": [
            {"value": value, "colour": list(PRODUCTS["mask"].colours[value]), "label": label}
            for value, label in PRODUCTS["mask"].values.items()
        ],
        "commands": {name: _command(name) for name in SHELLS},
    }


def _command(name: str) -> dict[str, Any]:
    command: click.Command = importlib.import_module(f"cli.commands.{name}").command
    parameters = [_parameter(name, p) for p in command.params if p.name not in NOT_IN_QGIS]
    return {"summary": COMMANDS[name], "help": command.help, "parameters": parameters}


def _parameter(command: str, parameter: click.Parameter) -> dict[str, Any]:
    key = str(parameter.name)
    option = "" if isinstance(parameter, click.Argument) else parameter.opts[-1]
    name = PLACES.get(key) or option.removeprefix("--").replace("-", "_").upper()
    label = (
        LABELS_OF.get(command, {}).get(name)
        or LABELS.get(name)
        or name.replace("_", " ").capitalize()
    )
    fields: dict[str, Any] = {
        "name": name, "key": key, "label": label, "option": option, "required": parameter.required, "unit": "",
        "advanced": key not in SHOWN_FIRST and key not in PLACES, "help": "", "choices": [], "default": None,
        "config_default": None,
    }  # fmt: skip
    if key in SETTINGS and _is_setting(parameter):
        return fields | _from_setting(key)
    kind = KINDS.get((command, key)) or _kind(parameter)
    fields |= {"kind": kind, "help": getattr(parameter, "help", None) or ""}
    # The default of an output is a file in the working folder, which has no meaning in QGIS.
    if (
        parameter.default is not None
        and isinstance(parameter.default, str | int)
        and key not in PLACES
    ):
        fields["default"] = parameter.default
    if isinstance(parameter.type, click.IntRange):
        fields["minimum"], fields["maximum"] = parameter.type.min, parameter.type.max
    return fields


def _is_setting(parameter: click.Parameter) -> bool:
    """Return whether an option sets the setting of its name. `tiler check --tile-size` does not."""
    help: str = SETTINGS[str(parameter.name)].metadata["help"]
    return (getattr(parameter, "help", None) or "").startswith(help.split(" [")[0])


def _from_setting(key: str) -> dict[str, Any]:
    spec = SETTINGS[key]
    kind, choices = spec.metadata["kind"], list(spec.metadata["choices"])
    help: str = spec.metadata["help"]
    if key == "method":
        from ptd.methods import METHODS

        kind, choices = "choice", [*METHODS, "keep"]
    elif key == "preset":
        from tiler.config.sources import preset_names

        kind, choices = "choice", list(preset_names())
    elif kind == "lengths":
        # The plugin loads one folder of results.
        kind, help = "length", help.partition(" With several")[0]
    default: Any = default_text(spec) or None
    if kind in OF_TYPE:
        default = OF_TYPE[kind](spec.default)
    return {
        "kind": {"pairs": "texts", "crs": "text"}.get(kind, kind),
        "choices": choices,
        "default": default,
        "config_default": _CONFIG_DEFAULTS[key],
        "unit": spec.metadata["unit"],
        "help": help,
    }


def _kind(parameter: click.Parameter) -> str:
    if isinstance(parameter.type, click.Path):
        return "files" if parameter.multiple else "file"
    if parameter.multiple:
        return "texts"
    return (
        "int"
        if isinstance(parameter.type, click.IntRange | click.types.IntParamType)
        else "text"
    )
