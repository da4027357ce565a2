"""Plugin of QGIS that offers ``tiler`` in the Processing toolbox; it needs Python 3.9 and nothing but QGIS."""

from __future__ import annotations

from typing import Any


def classFactory(interface: Any) -> Any:
    """Make the plugin; QGIS looks for this name."""
    from .provider import Plugin

    return Plugin(interface)
