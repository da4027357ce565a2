"""Runs in the Python of QGIS: an algorithm stopped and started again, and its results as layers of a project."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

from qgis.core import (
    QgsApplication,
    QgsFeature,
    QgsGeometry,
    QgsPointCloudLayer,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
)

application = QgsApplication([], False)
application.initQgis()
sys.path.insert(0, f"{QgsApplication.pkgDataPath()}/python/plugins")
sys.path.insert(0, sys.argv[1])

from processing.core.Processing import Processing  # noqa: E402
from processing.gui.Postprocessing import handleAlgorithmResults  # noqa: E402
from tiler_qgis import styles  # noqa: E402
from tiler_qgis.provider import Provider  # noqa: E402

Processing.initialize()
provider = Provider()
QgsApplication.processingRegistry().addProvider(provider)


class Watched(QgsProcessingFeedback):
    """Keeps what is told, and cancels at a stage."""

    def __init__(self, until: str = "") -> None:
        super().__init__(False)
        self.until = until
        self.titles: list[str] = []
        self.errors: list[str] = []
        self.commands: list[str] = []

    def setProgressText(self, text: str) -> None:
        self.titles.append(text)
        if text == self.until:
            self.cancel()

    def pushCommandInfo(self, info: str) -> None:
        self.commands.append(info)

    def reportError(self, error: str, fatalError: bool = False) -> None:
        self.errors.append(error)


def run(name: str, parameters: dict[str, Any], until: str = "") -> dict[str, Any]:
    """Run an algorithm as the dialog of QGIS does."""
    context, feedback = QgsProcessingContext(), Watched(until)
    context.setProject(QgsProject.instance())
    algorithm = QgsApplication.processingRegistry().createAlgorithmById(f"tiler:{name}")
    accepted, reason = algorithm.checkParameterValues(parameters, context)
    assert accepted, reason
    results, ok = algorithm.run(parameters, context, feedback)
    if ok and not feedback.isCanceled():
        assert handleAlgorithmResults(algorithm, context, feedback)
    return {
        "ok": ok,
        "results": results,
        "titles": feedback.titles,
        "commands": feedback.commands,
        "errors": feedback.errors,
    }


def layers() -> list[dict[str, Any]]:
    """The layers of the project, from top to bottom."""
    found = []
    for group in QgsProject.instance().layerTreeRoot().children():
        for node in group.children():
            layer = node.layer()
            entry = {
                "group": group.name(),
                "name": layer.name(),
                "shown": node.itemVisibilityChecked(),
            }
            entry["blend"] = int(layer.blendMode())
            if isinstance(layer, QgsRasterLayer):
                entry["renderer"] = layer.renderer().type()
                entry["legend"] = [label for label, _ in layer.legendSymbologyItems()]
            else:
                setup = layer.editorWidgetSetup(layer.fields().indexOf("action"))
                entry["widget"], entry["list"] = setup.type(), setup.config().get("map")
            found.append(entry)
    return found


parameters = json.loads(Path(sys.argv[2]).read_text())
told: dict[str, Any] = {
    "stopped": run("run", parameters, until=sys.argv[5]),
    "layers_then": layers(),
}
told["resumed"] = run("run", parameters)
shutil.copytree(parameters["OUTPUT"], Path(sys.argv[4]).with_name("then"))
told["layers"] = layers()
edits = QgsProject.instance().mapLayersByName("edits")[0]
corrections = json.loads(Path(sys.argv[3]).read_text())
assert edits.startEditing()
for action, z, bounds in corrections:
    feature = QgsFeature(edits.fields())
    feature.setGeometry(QgsGeometry.fromRect(QgsRectangle(*bounds)))
    feature["action"], feature["z"] = action, z
    assert edits.addFeature(feature)
again = {"OUTPUT": parameters["OUTPUT"], "EDITS": edits.id()}
told["unsaved"] = run("applyedits", again)
assert edits.commitChanges()
told["edited"] = run("applyedits", again)
told["layers_again"] = layers()
cloud = QgsPointCloudLayer("none/ept.json", "cloud", "ept")  # this QGIS opens no other kind
styles.cloud(cloud)
told["classes"] = [[int(c.value()), c.label()] for c in cloud.renderer().categories()]
Path(sys.argv[4]).write_text(json.dumps(told))
sys.stdout.flush()
os._exit(0)  # QGIS may crash when it is taken down without a desktop
