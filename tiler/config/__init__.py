"""The settings of a run, and the presets that they may start from."""

from tiler.config.settings import AUTO_WATER, NO_WATER, RunConfig
from tiler.config.sources import load_config, merged_pairs

__all__ = ["AUTO_WATER", "NO_WATER", "RunConfig", "load_config", "merged_pairs"]
