"""Where settings come from, and which of them win: a preset, then a TOML file, then the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ptd.params import UNIT_SUFFIXES
from tiler.config.parsing import parse_pairs
from tiler.config.presets import load_preset
from tiler.errors import ConfigError


def over_preset(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings given over those of their preset, whose parameters are left out if they are another method's."""
    if data.get("preset") is None:
        return data
    base = load_preset(data["preset"])
    if data.get("method", base.get("method")) != base.get("method"):
        base.pop("parameters", None)
    found = base | dict(data)
    found["parameters"] = merged_pairs(base.get("parameters", {}), data.get("parameters", {}))
    return found


def merged_pairs(base: Any, given: Any) -> dict[str, str]:
    """``name=value`` settings of a method, the given ones over the others, with or without the unit of a name."""
    over = dict(parse_pairs(given))
    bare = {_without_unit(name) for name in over}
    return {k: v for k, v in parse_pairs(base) if _without_unit(k) not in bare} | over


def _without_unit(name: str) -> str:
    for suffix in UNIT_SUFFIXES:
        name = name.removesuffix(suffix)
    return name


MOST_BYTES = 1 << 20
"""Of a file of settings: what is read of another file is bounded."""


def load_config(path: Path) -> dict[str, Any]:
    """The settings of a TOML file as plain values; a table ``[parameters]`` holds those of the method."""
    import tomllib

    try:
        with open(path, "rb") as stream:
            content = stream.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ConfigError(f"{path}: more than {MOST_BYTES >> 20} MiB; name a TOML file of settings")
        return tomllib.loads(content.decode("utf-8-sig"))  # editors of Windows begin files with a mark
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name a readable TOML file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is no UTF-8; save the file as UTF-8") from error
    except (ValueError, RecursionError) as error:  # of numbers and nesting without end as well
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
