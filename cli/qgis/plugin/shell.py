"""Base class of all algorithms: makes a call of ``tiler`` from the parameters, and follows it to its end."""

from __future__ import annotations

import html
import json
import re
import shlex
import time
from pathlib import Path
from typing import Any

from processing.core.ProcessingConfig import ProcessingConfig
from processing.core.ProcessingResults import resultsList
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingUtils,
)

from . import process
from .fields import FOLDER, make_parameters, numbers_of_names, read_value
from .process import PARTIAL, TABLE, CommandError, CommandResult, absolute

LOAD = "LOAD"
COMMAND = "TILER_COMMAND"
"""Name of the setting, in the options of Processing, that has the path of the command."""


def find_command() -> str:
    """Return the path of ``tiler``: from the options, else from the installation, else from ``PATH``."""
    return process.find_command(ProcessingConfig.getSetting(COMMAND) or TABLE["command"])


class CommandAlgorithm(QgsProcessingAlgorithm):
    """Algorithm that runs a command. Derived classes override the parts that differ."""

    command = ""
    shows_progress = True

    def __init__(self) -> None:
        super().__init__()
        self._arguments: list[str] = []
        self._place = self._page = ""
        self._load = False
        self._ended = CommandResult(process.INTERRUPTED, "")

    def createInstance(self) -> QgsProcessingAlgorithm:
        """Make a new instance, which QGIS needs for each use."""
        return type(self)()

    def name(self) -> str:
        """Return the name of the algorithm after ``tiler:``."""
        return self.command

    def displayName(self) -> str:
        """Return the name in the toolbox."""
        return self.command.capitalize()

    def shortDescription(self) -> str:
        """Return the description of the command in one line."""
        return str(TABLE["commands"][self.command]["summary"])

    def shortHelpString(self) -> str:
        """Return the help of the command and of each parameter."""
        command_entry = TABLE["commands"][self.command]
        paragraphs = (" ".join(p.split()) for p in command_entry["help"].split("\n\n"))
        text = "".join(f"<p>{html.escape(p)}</p>" for p in paragraphs)
        rows = ((p.description(), p.help()) for p in self.parameterDefinitions())
        return text + "".join(
            f"<p><b>{html.escape(d)}</b><br>{html.escape(h)}</p>" for d, h in rows if h
        )

    def initAlgorithm(self, configuration: Any = None) -> None:
        """Make parameters and outputs."""
        for spec in self.specs():
            for parameter in make_parameters(spec):
                self.addParameter(parameter)
        self.addOutput(
            QgsProcessingOutputNumber(
                "EXIT_CODE", "Exit code: 0 done; 5 done, but something was left out"
            )
        )
        self.add_outputs()

    def specs(self) -> list[dict[str, Any]]:
        """Return the entries of the table for the parameters of the command."""
        return list(TABLE["commands"][self.command]["parameters"])

    def add_outputs(self) -> None:
        """Add further parameters and outputs. Derived classes override this method."""

    def checkParameterValues(
        self, parameters: dict[str, Any], context: QgsProcessingContext
    ) -> Any:
        """Check the values as QGIS does, but also accept the names of products instead of their numbers."""
        numbers = {
            spec["name"]: numbers_of_names(spec, parameters[spec["name"]])
            for spec in self.specs()
            if spec["kind"] == "names" and parameters.get(spec["name"]) is not None
        }
        return super().checkParameterValues({**parameters, **numbers}, context)

    def prepareAlgorithm(
        self,
        parameters: dict[str, Any],
        context: QgsProcessingContext,
        feedback: QgsProcessingFeedback,
    ) -> bool:
        """Read all parameters here, because layers may only be read in this method."""
        try:
            self._arguments = self.make_arguments(parameters, context)
        except CommandError as error:
            raise QgsProcessingException(str(error)) from error
        has_load = LOAD in parameters or self.parameterDefinition(LOAD) is not None
        self._load = has_load and self.parameterAsBool(parameters, LOAD, context)
        return True

    def make_arguments(
        self, parameters: dict[str, Any], context: QgsProcessingContext
    ) -> list[str]:
        """Return the command line."""
        arguments = [find_command(), self.command]
        positionals: list[str] = []
        extent: list[str] = []
        for spec in self.specs():
            if spec["kind"] == "bounds":
                extent = [spec["name"], spec["option"]]
                continue
            value = read_value(self, spec, parameters, context)
            if spec["kind"] == "clouds":
                folder = self.parameterAsFile(parameters, FOLDER, context)
                value = [*(value or []), *([absolute(folder)] if folder else [])]
                if not value:
                    raise CommandError("INPUT: has no clouds; give files or a folder")
                positionals = value + positionals
            elif not spec["option"]:
                positionals.append(value)
            else:
                arguments += process.options(spec, value)
            if spec["name"] == "OUTPUT":
                self._place = value
        if self.shows_progress:
            arguments += ["--progress", "json"]
        if extent and parameters.get(extent[0]):
            arguments += [
                extent[1],
                *self._edges(extent[0], parameters, context, [*arguments, *positionals]),
            ]
        return [*arguments, *positionals]

    def _edges(
        self,
        name: str,
        parameters: dict[str, Any],
        context: QgsProcessingContext,
        command: list[str],
    ) -> list[str]:
        """Return west, south, east and north of an extent in the CRS of the clouds, which `tiler plan` prints."""
        given = parameters[name]
        extent = self.parameterAsExtent(parameters, name, context)
        if not isinstance(given, str) or "[" in given:
            at = command.index("--progress")
            plan = [command[0], "plan", *command[2:at], *command[at + 2 :], "--json"]
            plan_result = process.run_command(plan, lambda event: None, lambda: False)
            wkt = json.loads(plan_result.text)["crs"]
            extent_crs = self.parameterAsExtentCrs(parameters, name, context)
            clouds = (
                QgsCoordinateReferenceSystem.fromWkt(wkt)
                if wkt
                else QgsCoordinateReferenceSystem()
            )
            if extent_crs.isValid() and clouds.isValid() and extent_crs != clouds:
                transform = QgsCoordinateTransform(
                    extent_crs, clouds, context.transformContext()
                )
                extent = transform.transformBoundingBox(extent)
        edges = (extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum())
        return [repr(float(edge)) for edge in edges]

    def processAlgorithm(
        self,
        parameters: dict[str, Any],
        context: QgsProcessingContext,
        feedback: QgsProcessingFeedback,
    ) -> dict[str, Any]:
        """Run the command."""
        feedback.pushCommandInfo(shlex.join(self._arguments))
        teller = FeedbackListener(feedback)
        try:
            self._ended = process.run_command(self._arguments, teller, feedback.isCanceled)
        except CommandError as error:
            raise QgsProcessingException(str(error)) from error
        if self._ended.cancelled:
            feedback.pushWarning(
                "stopped; run the same algorithm with the same folder again to resume"
            )
            return {}
        for line in self._ended.text.splitlines():
            left_out = self._ended.code == PARTIAL and re.match(
                r"left out |failed |required .* NOT met$", line
            )
            (feedback.reportError if left_out else feedback.pushInfo)(line)
        if self._ended.code == PARTIAL:
            self.report_partial(feedback)
        return {"EXIT_CODE": self._ended.code, **self.outputs()}

    def report_partial(self, feedback: QgsProcessingFeedback) -> None:
        """Report that something is missing (exit code 5)."""
        feedback.reportError(
            "NOT COMPLETE: files, parts of files or tiles were left out (exit code 5); see the red lines and the report"
        )

    def outputs(self) -> dict[str, Any]:
        """Return the outputs of the algorithm."""
        return {"OUTPUT": self._place}

    def postProcessAlgorithm(
        self, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict[str, Any]:
        """Show the page, if there is one."""
        self.show_page(self._page, context, feedback)
        return {}

    def show_page(
        self, path: str, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> None:
        """Put a page into the viewer of results.

        The page is not an output of type HTML, because QGIS lists these as results even if the
        algorithm failed.
        """
        if path and context.project() is not None:
            resultsList.addResult(self.icon(), self.displayName(), time.localtime(), path)
            feedback.pushInfo(f"{path}: see Processing > Results Viewer")

    @property
    def to_load(self) -> bool:
        """Whether there is something to add to the project."""
        return self._load and self._ended.code in (0, PARTIAL)


class FeedbackListener:
    """Listener that shows the progress, stages and log lines of a command."""

    def __init__(self, feedback: QgsProcessingFeedback) -> None:
        self._feedback, self._title = feedback, ""

    def __call__(self, event: dict[str, Any]) -> None:
        """Show an object of ``--progress json``."""
        if event.get("progress") is not None:
            self._feedback.setProgress(100.0 * float(event["progress"]))
        title = event.get("title")
        if title and title != self._title:
            self._title = title
            self._feedback.setProgressText(title)
        if event.get("message") is not None:
            warning = event.get("level") == "warning"
            (self._feedback.pushWarning if warning else self._feedback.pushInfo)(
                str(event["message"])
            )


def write_page(name: str, body: str) -> str:
    """Write a page into the temporary folder of QGIS, and return its path."""
    path = QgsProcessingUtils.generateTempFilename(f"{name}.html")
    Path(path).write_text(
        f'<!doctype html><meta charset="utf-8"><title>{name}</title>{body}', "utf-8"
    )
    return str(path)
