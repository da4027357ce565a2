"""Widget for a list of files, which is only imported in the desktop application."""

from __future__ import annotations

from typing import Any

from processing.gui.wrappers import WidgetWrapper
from qgis.gui import QgsFileWidget, QgsGui


class FilesWrapper(WidgetWrapper):
    """Widget with a line of quoted paths or URLs, and a button that selects files.

    The widget of QGIS 3.22 tries to load each file as a layer, and drops files that are not
    layers.
    """

    def __new__(
        cls, parameter: Any, dialog: Any, row: int = 0, column: int = 0, **settings: Any
    ) -> Any:
        """Make this widget, or in the designer of models the widget of QGIS, which offers the inputs of the model."""
        if type(dialog).__name__ == "ModelerParametersDialog":
            registry = QgsGui.processingGuiRegistry()
            made = registry.createModelerParameterWidget(
                dialog.model, dialog.childId, parameter, dialog.context
            )
            made.setDialog(dialog)
            return made
        return super().__new__(cls)

    def createWidget(self, filter: str = "") -> Any:
        """Return the line and its button."""
        widget = QgsFileWidget()
        widget.setStorageMode(QgsFileWidget.StorageMode.GetMultipleFiles)
        widget.setFilter(filter)
        widget.fileChanged.connect(lambda: self.widgetValueHasChanged.emit(self))
        return widget

    def setValue(self, value: Any) -> None:
        """Show these files."""
        paths = value if isinstance(value, (list, tuple)) else [value] if value else []
        self.widget.setFilePath(" ".join(f'"{path}"' for path in paths))

    def value(self) -> Any:
        """Return the files, or None."""
        text = self.widget.filePath().strip()
        paths = QgsFileWidget.splitFilePaths(text) if '"' in text else [text]
        return [path for path in paths if path] or None
