"""The settings of a run, and the presets that they may start from."""

from tiler.config.settings import RunConfig, load_config, merged_pairs

__all__ = ["RunConfig", "load_config", "merged_pairs"]
