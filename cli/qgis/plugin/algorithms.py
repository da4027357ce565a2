"""The algorithms of the plugin. Each runs a command of ``tiler``."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingOutputFile,
    QgsProcessingOutputRasterLayer,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterFile,
    QgsProcessingParameterMultipleLayers,
    QgsProcessingParameterVectorLayer,
)

from . import process, results
from .process import PARTIAL, TABLE, CommandError, absolute
from .shell import LOAD, CommandAlgorithm, find_command, write_page


class RunAlgorithm(CommandAlgorithm):
    """``tiler run``."""

    command = "run"

    def add_outputs(self) -> None:
        """Add the terrain and the report as outputs, for models and for the viewer of results."""
        self.addParameter(
            QgsProcessingParameterBoolean(LOAD, "Add the results to the project", True)
        )
        self.addOutput(QgsProcessingOutputRasterLayer("DTM", "Terrain model"))
        self.addOutput(QgsProcessingOutputFile("REPORT", "Report"))

    def outputs(self) -> dict[str, Any]:
        """Return the folder of the results, and those of its files that other algorithms can use."""
        dtm, report = (
            results.raster(self._place, "dtm"),
            results.existing(self._place, "report.html"),
        )
        outputs = {"OUTPUT": self._place, "DTM": dtm, "REPORT": report}
        return {name: path for name, path in outputs.items() if path}

    def postProcessAlgorithm(
        self, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict[str, Any]:
        """Add the results to the project."""
        if self.to_load:
            results.load_folder(self._place, self._ended.code == PARTIAL, context, feedback)
            self.show_page(results.existing(self._place, "report.html"), context, feedback)
        return {}


class ApplyEdits(RunAlgorithm):
    """``tiler run`` with the settings of an earlier run and polygons of edits."""

    def name(self) -> str:
        """Return the name of the algorithm after ``tiler:``."""
        return "applyedits"

    def displayName(self) -> str:
        """Return the name in the toolbox."""
        return "Apply edits"

    def shortDescription(self) -> str:
        """Return a description in one line."""
        return "Correct the terrain with polygons. Only the affected parts are computed again."

    def shortHelpString(self) -> str:
        """Return the help: the purpose of the algorithm and the meaning of the polygons."""
        help = next(
            s["help"] for s in TABLE["commands"]["run"]["parameters"] if s["key"] == "edits"
        )
        return (
            "<p>Runs tiler again on a folder of results, with its settings and these edits. Only the affected parts "
            "are computed again.</p><p>Draw polygons in the layer <i>edits</i> that a run adds to the project, "
            "save the layer, and run this algorithm. The whole layer is applied each time: if you delete a polygon, "
            "its effect is undone.</p>"
            f"<p>{html.escape(help)}</p>"
        )

    def specs(self) -> list[dict[str, Any]]:
        """Return an empty list, because the settings are those of the earlier run."""
        return []

    def add_outputs(self) -> None:
        """Add the folder, the polygons, and the clouds in case run.json does not name them."""
        self.addParameter(
            QgsProcessingParameterFile(
                "OUTPUT",
                "Folder of the results of a run",
                QgsProcessingParameterFile.Behavior.Folder,
            )
        )
        self.addParameter(
            QgsProcessingParameterVectorLayer(
                "EDITS", "Edits (polygons)", [QgsProcessing.SourceType.TypeVectorPolygon]
            )
        )
        label = "Point clouds of the run (empty: the clouds listed in run.json)"
        self.addParameter(
            QgsProcessingParameterMultipleLayers(
                "INPUT", label, QgsProcessing.SourceType.TypeFile, optional=True
            )
        )
        super().add_outputs()

    def make_arguments(
        self, parameters: dict[str, Any], context: QgsProcessingContext
    ) -> list[str]:
        """Return the command of the earlier run with the edits."""
        self._place = absolute(self.parameterAsFile(parameters, "OUTPUT", context))
        run = results.read_run(self._place)
        given = [
            path for path in self.parameterAsFileList(parameters, "INPUT", context) if path
        ]
        return [
            find_command(),
            "run",
            *process.options_of_config("run", {**run["configuration"], "edits": None}),
            "--edits",
            self._edits(parameters, context),
            "--out",
            self._place,
            "--progress",
            "json",
            *([absolute(path) for path in given] or results.clouds_of(self._place, run)),
        ]

    def _edits(self, parameters: dict[str, Any], context: QgsProcessingContext) -> str:
        """Return the file of the layer of edits."""
        layer = self.parameterAsVectorLayer(parameters, "EDITS", context)
        if layer is None:
            raise CommandError(
                f"{parameters.get('EDITS')} is not a layer of polygons; give the layer edits"
            )
        path = layer.source().split("|")[0]
        if layer.isModified():
            raise CommandError(
                f"{layer.name()}: has unsaved changes; save the layer, then run this again"
            )
        if not Path(path).is_file():
            raise CommandError(
                f"{layer.name()} is not stored in a file; save it as a GeoPackage, then run this again"
            )
        return absolute(path)


class Preview(CommandAlgorithm):
    """``tiler preview``."""

    command = "preview"

    def add_outputs(self) -> None:
        """Add a page with the picture as an output, for the viewer of results."""
        self.addOutput(QgsProcessingOutputFile("PAGE", "Page with the picture"))

    def outputs(self) -> dict[str, Any]:
        """Write the page, and return picture and page."""
        lines = html.escape(self._ended.text)
        body = f'<p><img src="{html.escape(Path(self._place).as_uri())}"></p><pre>{lines}</pre>'
        self._page = write_page("preview", body)
        return {"OUTPUT": self._place, "PAGE": self._page}


class Classify(CommandAlgorithm):
    """``tiler classify``."""

    command = "classify"

    def add_outputs(self) -> None:
        """Add the parameter that decides whether the cloud is added to the project."""
        self.addParameter(
            QgsProcessingParameterBoolean(LOAD, "Add the classified cloud to the project", True)
        )

    def postProcessAlgorithm(
        self, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict[str, Any]:
        """Add the cloud to the project."""
        if self.to_load:
            results.load_cloud(self._place, context, feedback)
        return {}


class Check(CommandAlgorithm):
    """``tiler check``."""

    command = "check"
    shows_progress = False

    def add_outputs(self) -> None:
        """Add a page with the figures as an output, for the viewer of results."""
        self.addOutput(QgsProcessingOutputFile("PAGE", "Page with the figures"))

    def report_partial(self, feedback: QgsProcessingFeedback) -> None:
        """Raise an error with the requirements that are not met, because the check has failed."""
        unmet = [line for line in self._ended.text.splitlines() if line.endswith("NOT met")]
        raise QgsProcessingException("; ".join(unmet) or "a required check failed")

    def outputs(self) -> dict[str, Any]:
        """Write the page, and return it."""
        self._page = write_page("check", f"<pre>{html.escape(self._ended.text)}</pre>")
        return {"PAGE": self._page}
