"""Plugin of QGIS that offers ``tiler`` in the Processing toolbox. It needs only QGIS and Python 3.9."""

from __future__ import annotations

from typing import Any


def classFactory(interface: Any) -> Any:
    """Make the plugin. QGIS calls this function by its name."""
    from .provider import Plugin

    return Plugin(interface)
