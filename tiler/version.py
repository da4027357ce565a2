"""Version of the distribution, which hatchling reads."""

__version__ = "0.1.0"
