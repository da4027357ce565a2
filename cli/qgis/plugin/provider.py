"""The plugin and its provider: the algorithms, and the setting with the path of the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsApplication, QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .algorithms import ApplyEdits, Check, Classify, Preview, RunAlgorithm
from .process import TABLE
from .shell import COMMAND

ICON = str(Path(__file__).with_name("icon.png"))


class Plugin:
    """Object that QGIS loads, which adds the provider and an entry in the menu of plugins.

    Parameters
    ----------
    interface : QgisInterface or None
        The desktop application, or None in ``qgis_process``.
    """

    def __init__(self, interface: Any) -> None:
        self._interface = interface
        self._provider: Provider | None = None
        self._menu: Any = None

    def initProcessing(self) -> None:
        """Add the provider. ``qgis_process`` calls only this method."""
        self._provider = Provider()
        QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self) -> None:
        """Add the provider and the menu in the desktop application."""
        self.initProcessing()
        self._menu = self._interface.pluginMenu().addMenu(QIcon(ICON), "tiler")
        self._menu.addAction("The command...", lambda: self.show_dialog())

    def show_dialog(self) -> None:
        """Show the dialog that finds and tests the command."""
        from .dialog import CommandDialog

        configured = ProcessingConfig.getSetting(COMMAND) or ""
        CommandDialog(configured, _save_command, self._interface.mainWindow()).exec()

    def unload(self) -> None:
        """Remove the provider and the entry of the menu."""
        if self._menu is not None:
            self._interface.pluginMenu().removeAction(self._menu.menuAction())
            self._menu = None
        if self._provider is not None:
            QgsApplication.processingRegistry().removeProvider(self._provider)
            self._provider = None


def _save_command(path: str) -> None:
    ProcessingConfig.setSettingValue(COMMAND, path)


class Provider(QgsProcessingProvider):
    """The algorithms ``tiler:run``, ``tiler:preview``, ``tiler:classify``, ``tiler:check`` and ``tiler:applyedits``."""

    def id(self) -> str:
        """Return the first part of the algorithms' names."""
        return "tiler"

    def name(self) -> str:
        """Return the name in the toolbox."""
        return "tiler"

    def icon(self) -> QIcon:
        """Return the icon for the toolbox and the options."""
        return QIcon(ICON)

    def longName(self) -> str:
        """Return the name in the list of providers."""
        return f"tiler {TABLE['version']}: point clouds to terrain"

    def load(self) -> bool:
        """Add the setting and the algorithms."""
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        # The setting is empty at first. QGIS saves the shown value, which would hide the path
        # of a later installation.
        label = f"Path of the command tiler (empty: {TABLE['command'] or 'the one in PATH'})"
        setting = Setting(self.name(), COMMAND, label, "", valuetype=Setting.STRING)
        ProcessingConfig.addSetting(setting)
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        """Remove the setting."""
        ProcessingConfig.removeSetting(COMMAND)

    def loadAlgorithms(self) -> None:
        """Make the algorithms."""
        for made in (RunAlgorithm, Preview, Classify, Check, ApplyEdits):
            self.addAlgorithm(made())
