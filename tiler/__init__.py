"""Terrain models from point clouds, for areas from a city to a country.

The functions are `run`, `classify`, `check`, `check_clouds` and `open_store` (docs/python.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tiler.version import __version__

if TYPE_CHECKING:
    from tiler.api import AcceptanceResult as AcceptanceResult
    from tiler.api import CheckResult as CheckResult
    from tiler.api import ClassifyResult as ClassifyResult
    from tiler.api import ConfigError as ConfigError
    from tiler.api import InputError as InputError
    from tiler.api import ProcessingError as ProcessingError
    from tiler.api import Progress as Progress
    from tiler.api import RunConfig as RunConfig
    from tiler.api import RunResult as RunResult
    from tiler.api import TilerError as TilerError
    from tiler.api import check as check
    from tiler.api import check_clouds as check_clouds
    from tiler.api import classify as classify
    from tiler.api import open_store as open_store
    from tiler.api import run as run

__all__ = [
    "AcceptanceResult",
    "CheckResult",
    "ClassifyResult",
    "ConfigError",
    "InputError",
    "ProcessingError",
    "Progress",
    "RunConfig",
    "RunResult",
    "TilerError",
    "__version__",
    "check",
    "check_clouds",
    "classify",
    "open_store",
    "run",
]


def __getattr__(name: str) -> Any:
    """Load the names of the package when they are first used, so that importing the package is fast."""
    if name in __all__:
        from tiler import api

        return getattr(api, name)
    raise AttributeError(f"module 'tiler' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the names of the package, loaded or not."""
    return sorted({*globals(), *__all__})
