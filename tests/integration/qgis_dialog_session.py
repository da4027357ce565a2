"""Runs in the Python of QGIS, or with PyQt6 in place of QGIS 4: the menu and the dialog of the plugin, and its enums.

Arguments: the folder of plugins, a command, another program, the file for what was seen.
Without QGIS, modules stand in for its libraries; those of Qt are real.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import types
from pathlib import Path
from typing import Any

sys.path.insert(0, sys.argv[1])


class StandIn(types.ModuleType):
    """A module of QGIS: each name in it is an empty class."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        made = type(name, (), {})
        setattr(self, name, made)
        return made


def stand_in_for_qgis() -> None:
    """Let modules of QGIS be found that have PyQt6 inside."""
    names = (
        "qgis",
        "qgis.core",
        "qgis.gui",
        "qgis.PyQt",
        "processing",
        "processing.core",
        "processing.gui",
    )
    more = (
        "processing.core.ProcessingConfig",
        "processing.core.ProcessingResults",
        "processing.gui.wrappers",
    )
    for name in (*names, *more):
        sys.modules[name] = StandIn(name)
    for name in ("QtCore", "QtGui", "QtWidgets"):
        sys.modules[f"qgis.PyQt.{name}"] = importlib.import_module(f"PyQt6.{name}")


try:
    from qgis.core import QgsApplication
except ImportError:
    stand_in_for_qgis()
    from PyQt6.QtWidgets import QApplication

    application: Any = QApplication([])
else:
    application = QgsApplication([], True)
    application.initQgis()
    sys.path.insert(0, f"{QgsApplication.pkgDataPath()}/python/plugins")

from qgis.PyQt.QtCore import QT_VERSION_STR  # noqa: E402
from qgis.PyQt.QtWidgets import QMainWindow, QMenu  # noqa: E402
from tiler_qgis import dialog, provider, styles  # noqa: E402

for path in Path(sys.argv[1], "tiler_qgis").glob("*.py"):
    importlib.import_module(f"tiler_qgis.{path.stem}")


class Interface:
    """The desktop application, as far as the plugin uses it."""

    def __init__(self) -> None:
        self.window, self.menu = QMainWindow(), QMenu()

    def mainWindow(self) -> Any:
        return self.window

    def pluginMenu(self) -> Any:
        return self.menu


class Layer:
    """Takes a style."""

    def setRenderer(self, renderer: Any) -> None:
        pass

    def brightnessFilter(self) -> Any:
        return types.SimpleNamespace(setBrightness=lambda value: None)

    def setBlendMode(self, mode: Any) -> None:
        self.mode = mode


def look_at(path: str) -> dict[str, str]:
    """What the dialog says of a path, and what it keeps."""
    kept: list[str] = []
    shown = dialog.CommandDialog(path, kept.append, interface.window)
    shown.accept()
    return {"status": shown.status.text(), "install": shown.install.text(), "kept": kept[0]}


interface = Interface()
provider.Plugin.initProcessing = lambda self: None
plugin = provider.Plugin(interface)
plugin.initGui()
(submenu,) = interface.menu.actions()
entries = [action.text() for action in submenu.menu().actions()]
has_icon = not submenu.icon().isNull() and bool(submenu.icon().availableSizes())
plugin.unload()
layer = Layer()
styles._darken(layer, None)
told = {
    "qt": QT_VERSION_STR,
    "entries": entries,
    "has_icon": has_icon,
    "left": len(interface.menu.actions()),
    "blend": getattr(layer.mode, "value", layer.mode),
    "works": look_at(sys.argv[2]),
    "other": look_at(sys.argv[3]),
    "none": look_at("/none/tiler"),
}
Path(sys.argv[4]).write_text(json.dumps(told))
sys.stdout.flush()
os._exit(0)  # QGIS may crash when it is taken down without a desktop
