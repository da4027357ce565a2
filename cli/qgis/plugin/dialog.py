"""The dialog that finds the command, explains its installation, and tests it."""

from __future__ import annotations

from typing import Any, Callable

from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
)

from . import process
from .process import INSTALL, TABLE, CommandError

HOW = (
    "The plugin calls the command <i>tiler</i>, which is a separate program that the plugin does not install. Install "
    "the command in a terminal, in an environment of Python 3.11 or newer that is not the environment of QGIS:"
)


class CommandDialog(QDialog):
    """Dialog with the path of the command, instructions to install it, and a button that tests it.

    Parameters
    ----------
    configured : str
        Path in the options of Processing. If it is empty, the plugin looks for the command.
    save : callable
        Function that stores the new path.
    parent : QWidget, optional
    """

    def __init__(
        self, configured: str, save: Callable[[str], None], parent: Any = None
    ) -> None:
        super().__init__(parent)
        self._save = save
        self.setWindowTitle("tiler: the command")
        self.path = QLineEdit(configured)
        self.path.setPlaceholderText(
            TABLE["command"] or "empty: searched in PATH and ~/.local/bin"
        )
        self.install = QLineEdit(INSTALL)
        self.install.setReadOnly(True)
        self.status = QLabel()
        self.status.setWordWrap(True)
        self.status.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._lay_out()
        self.test()

    def _lay_out(self) -> None:
        how = QLabel(HOW)
        how.setWordWrap(True)
        browse, test = QPushButton("Browse..."), QPushButton("Test")
        browse.clicked.connect(lambda: self.browse())
        test.clicked.connect(lambda: self.test())
        row = QHBoxLayout()
        for widget in (self.path, browse, test):
            row.addWidget(widget)
        kinds = QDialogButtonBox.StandardButton
        buttons = QDialogButtonBox(kinds.Save | kinds.Cancel)
        buttons.accepted.connect(lambda: self.accept())
        buttons.rejected.connect(lambda: self.reject())
        column = QVBoxLayout(self)
        column.addWidget(how)
        column.addWidget(self.install)
        column.addWidget(QLabel("Path of the command (empty: the plugin looks for it):"))
        column.addLayout(row)
        column.addWidget(self.status)
        column.addWidget(buttons)

    def browse(self) -> None:
        """Choose a file as the command, and test it."""
        chosen, _ = QFileDialog.getOpenFileName(self, "The command tiler", self.path.text())
        if chosen:
            self.path.setText(chosen)
            self.test()

    def test(self) -> None:
        """Find the command, call it, and show the result."""
        try:
            path = process.find_command(self.path.text().strip() or TABLE["command"])
            version = process.version_of(path)
        except CommandError as error:
            self.status.setText(str(error))
            return
        text = f"{path} works: tiler {version}"
        if version != TABLE["version"]:
            text += f"; this plugin belongs to tiler {TABLE['version']}: run `tiler qgis install`, then restart QGIS"
        self.status.setText(text)

    def accept(self) -> None:
        """Save the path, and close the dialog."""
        self._save(self.path.text().strip())
        super().accept()
