"""City- to country-scale terrain from point clouds: a tile store, a scheduler, and the stages between."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tiler.version import __version__

if TYPE_CHECKING:
    from tiler.pipeline import run as run
    from tiler.store import open_store as open_store

__all__ = ["__version__", "open_store", "run"]


def __getattr__(name: str) -> Any:
    """Load the two entry points when they are first used: importing the package stays cheap."""
    if name == "run":
        from tiler.pipeline import run

        return run
    if name == "open_store":
        from tiler.store import open_store

        return open_store
    raise AttributeError(f"module 'tiler' has no attribute {name!r}")
