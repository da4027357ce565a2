"""The plugin and its provider: the algorithms, and the setting that says where the command is."""

from __future__ import annotations

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsApplication, QgsProcessingProvider

from .algorithms import ApplyEdits, Check, Classify, Preview, Run
from .process import TABLE
from .shell import COMMAND


class Plugin:
    """What QGIS loads; it only adds the provider."""

    def __init__(self) -> None:
        self._provider: Provider | None = None

    def initProcessing(self) -> None:
        """Add the provider; all that ``qgis_process`` calls."""
        self._provider = Provider()
        QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self) -> None:
        """Begin in the desktop application."""
        self.initProcessing()

    def unload(self) -> None:
        """Take the provider away."""
        if self._provider is not None:
            QgsApplication.processingRegistry().removeProvider(self._provider)
            self._provider = None


class Provider(QgsProcessingProvider):
    """The algorithms ``tiler:run``, ``tiler:preview``, ``tiler:classify``, ``tiler:check`` and ``tiler:applyedits``."""

    def id(self) -> str:
        """First part of the algorithms' names."""
        return "tiler"

    def name(self) -> str:
        """In the toolbox."""
        return "tiler"

    def longName(self) -> str:
        """In the list of providers."""
        return f"tiler {TABLE['version']}: point clouds to terrain"

    def load(self) -> bool:
        """Add the setting and the algorithms."""
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        # Empty at first: QGIS keeps what it shows there, which would be in the way of a later installation.
        label = f"Path of the command tiler (empty: {TABLE['command'] or 'that of PATH'})"
        setting = Setting(self.name(), COMMAND, label, "", valuetype=Setting.STRING)
        ProcessingConfig.addSetting(setting)
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        """Take the setting away."""
        ProcessingConfig.removeSetting(COMMAND)

    def loadAlgorithms(self) -> None:
        """Make the algorithms."""
        for made in (Run, Preview, Classify, Check, ApplyEdits):
            self.addAlgorithm(made())
