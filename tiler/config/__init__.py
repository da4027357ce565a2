"""The settings of a run, and the presets from which they may start."""

from tiler.config.parsing import plain_value
from tiler.config.settings import (
    AUTO_WATER,
    LOW_AS_NOISE,
    NO_WATER,
    VOID_CANOPY,
    RunConfig,
    without_folders,
)
from tiler.config.sources import load_config, merged_pairs

__all__ = [
    "AUTO_WATER",
    "LOW_AS_NOISE",
    "NO_WATER",
    "VOID_CANOPY",
    "RunConfig",
    "load_config",
    "merged_pairs",
    "plain_value",
    "without_folders",
]
