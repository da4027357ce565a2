"""Specifications of surveys: the limits of some rows, from a TOML file or one that comes with tiler.

`are_clouds` says whether the arguments of ``tiler check`` are clouds, a DTM, or the results of a run.
"""

from __future__ import annotations

import glob
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from tiler.apps.acceptance.counts import GPS_KINDS
from tiler.apps.acceptance.measurements import Row
from tiler.apps.acceptance.rows import ROWS
from tiler.apps.acceptance.separation import MAX_LIMIT_M
from tiler.config import load_config
from tiler.core.units import parse_area, parse_length
from tiler.errors import ConfigError
from tiler.inputs import is_list
from tiler.io.cloud_formats import FORMAT_NAMES, SUFFIXES
from tiler.io.locations import is_url, without_query
from tiler.io.result_folder import give_results, is_results, resolution_folders

_FOLDER = files("tiler.config") / "specifications"


@dataclass(frozen=True)
class Specification:
    """Name of a specification, and the limit of each row that it asks for: a number, or a list of allowed values."""

    name: str
    limits: Mapping[str, Any]

    @property
    def pulse_spacing_m(self) -> float | None:
        """Nominal pulse spacing that is asked for, or None."""
        if "pulse_spacing" in self.limits:
            return float(self.limits["pulse_spacing"])
        density = self.limits.get("pulse_density")
        return None if density is None else 1 / math.sqrt(density)


@cache
def specification_names() -> tuple[str, ...]:
    """Return the names of the specifications that come with tiler, sorted."""
    found = (item.name for item in _FOLDER.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


def read_specification(name: str) -> Specification:
    """Return a specification by its name or from a TOML file.

    Raises
    ------
    ConfigError
        There is no such specification, or a key or a value is not valid.
    """
    if name in specification_names():
        values = tomllib.loads(_FOLDER.joinpath(f"{name}.toml").read_text("utf-8"))
    elif Path(name).suffix.lower() == ".toml":
        values = load_config(Path(name))
    else:
        names = ", ".join(specification_names())
        raise ConfigError(f"--spec {name}: choose one of {names}, or give a file FILE.toml")
    rows = {row.name: row for row in ROWS}
    for key in values:
        if key not in rows:
            near = get_close_matches(key, rows, 1)
            meant = (
                f"did you mean {near[0]}?" if near else "see docs/acceptance.md for all keys"
            )
            raise ConfigError(f"--spec {name}: {key} is not a row of the check; {meant}")
    if not values:
        raise ConfigError(f"--spec {name}: asks for nothing; give at least one row")
    return Specification(
        name, {key: _limit(f"--spec {name}: {key}", rows[key], values[key]) for key in values}
    )


def _limit(where: str, row: Row, value: Any) -> Any:
    if row.limit == "only":
        kind = str if row.name in ("las_version", "gps_time") else int
        is_list = isinstance(value, list) and value
        if not is_list or any(isinstance(v, bool) or not isinstance(v, kind) for v in value):
            example = '["1.4"]' if kind is str else "[1, 2]"
            raise ConfigError(f"{where} = {value!r}: must be a list of values like {example}")
        unknown = [v for v in value if row.name == "gps_time" and v not in GPS_KINDS]
        if unknown:
            raise ConfigError(f"{where} = {value!r}: choose from {', '.join(GPS_KINDS)}")
        return value
    try:
        if row.unit == "m" and isinstance(value, str):
            value = float(parse_length(value))
        elif row.unit == "m2" and isinstance(value, str):
            value = float(parse_area(value))
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0 <= value < math.inf:
        raise ConfigError(f"{where} = {value!r}: must be a number of 0 or above")
    if row.unit == "%" and not 1 < value <= 100:
        raise ConfigError(f"{where} = {value!r}: must be a percentage above 1, 100 at most")
    if row.name == "repeatability" and value > MAX_LIMIT_M:
        raise ConfigError(
            f"{where} = {value!r}: must be {MAX_LIMIT_M:g} m or below, as rougher cells are not even"
        )
    if value == 0 and row.name in ("pulse_spacing", "pulse_density"):
        raise ConfigError(f"{where} = {value!r}: must be above 0")
    return value


def are_clouds(paths: Sequence[str]) -> bool:
    """Return whether all paths are clouds, lists, globs or folders of clouds.

    Raise ConfigError if only some of them are, or if there are several that are none.
    """
    others = [path for path in paths if not _is_cloud(path)]
    if not others:
        return bool(paths)
    if len(paths) > 1:
        raise ConfigError(
            f"{others[0]}: is not a cloud; give one DTM, one OUT folder, or only {FORMAT_NAMES} clouds"
        )
    return False


def _is_cloud(text: str) -> bool:
    if is_list(text) or Path(without_query(text)).suffix.lower() in SUFFIXES:
        return True
    if is_url(text):
        return False
    if os.path.isdir(text):
        if is_results(text):
            return False
        if resolution_folders(text):
            raise ConfigError(f"{text}: has no results of a run; {give_results(text)}")
        names = (name for _, _, names in os.walk(text) for name in names)
        return any(Path(name).suffix.lower() in SUFFIXES for name in names)
    if glob.has_magic(text) and not os.path.lexists(text):
        return any(_is_cloud(match) for match in glob.iglob(text, recursive=True))
    return False
