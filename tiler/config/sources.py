"""Sources of settings: presets, TOML files, which override a preset, and the command line, which overrides both."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from ptd.params import UNIT_SUFFIXES
from tiler.config.parsing import parse_pairs
from tiler.errors import ConfigError

_PRESETS = files("tiler.config") / "presets"
"""Folder of presets: settings for a kind of data or for a specification, each in a commented TOML file."""


@cache
def preset_names() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    found = (item.name for item in _PRESETS.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


def preset_text(name: str) -> str:
    """Return the text of a preset, whose first line describes its purpose, or raise ConfigError."""
    if name not in preset_names():
        raise ConfigError(f"preset {name!r}: choose one of {', '.join(preset_names())}")
    return _PRESETS.joinpath(f"{name}.toml").read_text("utf-8")


def load_preset(name: str) -> dict[str, Any]:
    """Return the settings of a preset as plain values, or raise ConfigError."""
    return tomllib.loads(preset_text(name))


def over_preset(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings, completed with the settings of their preset.

    If the preset is for another method, its parameters are left out.
    """
    if data.get("preset") is None:
        return data
    base = load_preset(data["preset"])
    if data.get("method", base.get("method")) != base.get("method"):
        base.pop("parameters", None)
    found = base | dict(data)
    found["parameters"] = merged_pairs(base.get("parameters", {}), data.get("parameters", {}))
    return found


def merged_pairs(base: Any, given: Any) -> dict[str, str]:
    """Return the parameters of a method, where ``given`` overrides ``base``.

    The unit at the end of a name may be left out.
    """
    over = dict(parse_pairs(given))
    bare = {_without_unit(name) for name in over}
    kept = {name: value for name, value in parse_pairs(base) if _without_unit(name) not in bare}
    return kept | over


def _without_unit(name: str) -> str:
    for suffix in UNIT_SUFFIXES:
        name = name.removesuffix(suffix)
    return name


MAX_BYTES = 1 << 20
"""Largest size of a file of settings. The limit keeps a wrong file from filling the memory."""


def load_config(path: Path) -> dict[str, Any]:
    """Return the settings of a TOML file as plain values, or raise ConfigError.

    Its table ``[parameters]`` contains the parameters of the method.
    """
    try:
        with open(path, "rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ConfigError(
                f"{path}: has more than {MAX_BYTES >> 20} MiB; give a TOML file of settings"
            )
        # Windows editors write a byte order mark first
        return tomllib.loads(content.decode("utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable TOML file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8"
        ) from error
    # Very long numbers and deep nesting raise these, too.
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not valid TOML ({error}); correct the file") from error
