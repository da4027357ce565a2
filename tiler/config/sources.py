"""Combines the sources of settings: a TOML file wins over a preset, and the command line over both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ptd.params import UNIT_SUFFIXES
from tiler.config.parsing import parse_pairs
from tiler.config.presets import load_preset
from tiler.errors import ConfigError


def over_preset(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings, with those of their preset where they give none; parameters of another method are left out."""
    if data.get("preset") is None:
        return data
    base = load_preset(data["preset"])
    if data.get("method", base.get("method")) != base.get("method"):
        base.pop("parameters", None)
    found = base | dict(data)
    found["parameters"] = merged_pairs(base.get("parameters", {}), data.get("parameters", {}))
    return found


def merged_pairs(base: Any, given: Any) -> dict[str, str]:
    """Parameters of a method, where ``given`` wins over ``base``; a name may lack the unit at its end."""
    over = dict(parse_pairs(given))
    bare = {_without_unit(name) for name in over}
    kept = {name: value for name, value in parse_pairs(base) if _without_unit(name) not in bare}
    return kept | over


def _without_unit(name: str) -> str:
    for suffix in UNIT_SUFFIXES:
        name = name.removesuffix(suffix)
    return name


MOST_BYTES = 1 << 20
"""Largest file of settings, so that a wrong file does not fill the memory."""


def load_config(path: Path) -> dict[str, Any]:
    """The settings of a TOML file as plain values; its table ``[parameters]`` holds the parameters of the method."""
    import tomllib

    try:
        with open(path, "rb") as stream:
            content = stream.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ConfigError(f"{path}: more than {MOST_BYTES >> 20} MiB; give a TOML file of settings")
        return tomllib.loads(
            content.decode("utf-8-sig")
        )  # Windows editors begin files with a byte order mark
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable TOML file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from error
    except (ValueError, RecursionError) as error:  # also raised for endless numbers and endless nesting
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
