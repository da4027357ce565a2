"""Presets: settings for a kind of data or for a specification, each in a commented TOML file."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from tiler.errors import ConfigError


@cache
def preset_names() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    found = (item.name for item in files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


def preset_text(name: str) -> str:
    """Return the text of a preset, whose first line describes its purpose, or raise ConfigError."""
    if name not in preset_names():
        raise ConfigError(f"preset {name!r}: choose one of {', '.join(preset_names())}")
    return files(__name__).joinpath(f"{name}.toml").read_text("utf-8")


def load_preset(name: str) -> dict[str, Any]:
    """Return the settings of a preset as plain values, or raise ConfigError."""
    return tomllib.loads(preset_text(name))
