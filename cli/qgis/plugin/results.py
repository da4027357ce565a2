"""Layers of the project for the results of a run, in one group and in the right order."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Callable, NamedTuple

from qgis.core import (
    Qgis,
    QgsMapLayer,
    QgsPointCloudLayer,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
    QgsProject,
    QgsProviderRegistry,
    QgsRasterLayer,
    QgsVectorFileWriter,
    QgsVectorLayer,
)

from . import styles
from .process import TABLE, CommandError, raster_file

KEY = "tiler/result"
"""Property of a layer (the result and the folder that it shows) and of a group (the folder)."""
RANK = "tiler/rank"
"""Property of an entry in the tree of layers: its rank in its group."""
LOWEST = 1000
EDITS_FIELDS = "field=action:string(10)&field=z:double&field=note:string(200)"

_KEPT: list[Any] = []
"""Post-processors. They are kept here because QGIS does not keep them alive."""


class Wanted(NamedTuple):
    """Specification of a layer: name, factory, style and visibility."""

    key: str
    name: str
    make: Callable[[str], QgsMapLayer]
    style: Callable[..., None]
    shown: bool


def existing(folder: str, name: str) -> str:
    """Return the path of a file in a folder, or an empty text if it does not exist."""
    path = Path(folder) / name
    return str(path) if path.is_file() else ""


def raster(folder: str, name: str) -> str:
    """Return the path of a product, in one file or in sheets, or an empty text if it does not exist."""
    try:
        file = raster_file(read_run(folder)["configuration"], name)
    except CommandError:  # A finished run whose run.json was removed.
        file = raster_file({}, name)
    return existing(folder, file) or existing(folder, f"{name}.vrt")


def read_run(folder: str) -> dict[str, Any]:
    """Return the content of run.json in a folder, or raise CommandError."""
    path = Path(folder) / "run.json"
    try:
        run = json.loads(path.read_text("utf-8"))
        if not isinstance(run["configuration"], dict):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CommandError(
            f"{folder}: does not contain results of tiler (run.json cannot be read); give the folder of a run"
        ) from error
    return dict(run)


def clouds_of(folder: str, run: dict[str, Any]) -> list[str]:
    """Return the INPUT of a run, or raise CommandError if run.json does not have absolute paths."""
    given = [str(path) for path in run.get("given", ())]
    if not given or not all("://" in path or Path(path).is_absolute() for path in given):
        raise CommandError(
            f"{folder}: its run.json does not contain the full paths of the clouds; give the point clouds of the run"
        )
    return given


def load_folder(
    folder: str,
    incomplete: bool,
    context: QgsProcessingContext,
    feedback: QgsProcessingFeedback,
) -> None:
    """Add the results in a folder to the project, and read layers again that the project already has."""
    if context.project() is None:
        return
    if not Path(folder).is_dir():
        feedback.pushWarning(
            f"{folder} is not a folder on this machine, so its results are not added to the project"
        )
        return
    title = Path(folder).name + (" (NOT COMPLETE)" if incomplete else "")
    group = _group_of(context.project().layerTreeRoot(), folder)
    if group is not None:
        group.setName(title)
    for rank, layer in enumerate(_wanted(folder, feedback)):
        _add(f"{folder}|{layer.key}", folder, title, rank, layer, context)
    _add_clouds(folder, title, context, feedback)


def load_cloud(
    path: str, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> None:
    """Add a classified cloud to the project, if this QGIS can show one."""
    if context.project() is None:
        return
    layer = _cloud(path, path, Path(path).stem, True)
    if layer is None:
        feedback.pushWarning(
            f"{path} is not added to the project, because this QGIS ({Qgis.QGIS_VERSION}) cannot show LAS and LAZ"
        )
    else:
        _add(path, "", "", 0, layer, context)


def _cloud(path: str, key: str, name: str, shown: bool) -> Wanted | None:
    """Return the layer of a cloud, or None if this QGIS cannot show its format."""
    there = QgsProviderRegistry.instance().providerList()
    kinds = (
        ("vpc",)
        if path.endswith(".vpc")
        else ("copc", "pdal")
        if path.endswith(".copc.laz")
        else ("pdal",)
    )
    provider = next((kind for kind in kinds if kind in there), None)
    if provider is None:
        return None
    return Wanted(
        key, name, lambda n: QgsPointCloudLayer(path, n, provider), styles.cloud, shown
    )


def _wanted(folder: str, feedback: QgsProcessingFeedback) -> list[Wanted]:
    """Return specifications of the layers for the results in a folder, from the top of the map down."""
    layers: list[Wanted] = []

    def vector(name: str, table: str, label: str, style: Callable[..., None]) -> None:
        path = existing(folder, f"{name}.gpkg")
        source = f"{path}|layername={table}"
        if path and QgsVectorLayer(source, "", "ogr").isValid():
            key = f"{name}:{table}"
            layers.append(
                Wanted(key, label, lambda n: QgsVectorLayer(source, n, "ogr"), style, True)
            )

    _make_edits(folder, feedback)
    for table in _tables(existing(folder, "edits.gpkg")):
        vector("edits", table, "edits", styles.edits)
    vector("review", "review", "places to review", styles.as_in_file)
    vector("spots", "spots", "spot heights", styles.spots)
    vector("contours", "contours", "contours", styles.contours)
    vector("outline", "outline", "outline of the survey", styles.outline)
    vector("bridges", "bridges", "removed bridges", styles.bridges)
    vector("water", "flow", "flow of rivers", styles.flow)
    vector("water", "water", "water", styles.water)
    terrain = raster(folder, "dtm")
    if raster(folder, "hillshade"):
        layers.append(_raster(folder, "hillshade", "hillshade", styles.grey_shade, True))
    elif terrain:
        layers.append(
            Wanted(
                "shade", "hillshade", lambda n: QgsRasterLayer(terrain, n), styles.shade, True
            )
        )
    if raster(folder, "mask"):  # The mask lies below the hillshade and above the heights.
        layers.append(_raster(folder, "mask", "source of heights", styles.mask, False))
    if terrain:
        layers.append(_raster(folder, "dtm", "terrain", styles.heights, True))
    rest = (name for name in TABLE["products"] if name not in ("dtm", "hillshade", "mask"))
    layers.extend(
        _raster(folder, name, name, styles.heights, False)
        for name in rest
        if raster(folder, name)
    )
    return layers


def _raster(
    folder: str, name: str, label: str, style: Callable[..., None], shown: bool
) -> Wanted:
    return Wanted(name, label, lambda n: QgsRasterLayer(raster(folder, name), n), style, shown)


def _tables(path: str) -> list[str]:
    if not path:
        return []
    layer = QgsVectorLayer(path, "", "ogr")
    return (
        [part.split("!!::!!")[1] for part in layer.dataProvider().subLayers()]
        if layer.isValid()
        else []
    )


def _make_edits(folder: str, feedback: QgsProcessingFeedback) -> None:
    """Write an empty layer for edits next to the results, unless there is one."""
    path, terrain = Path(folder) / "edits.gpkg", raster(folder, "dtm")
    if path.exists() or not terrain:
        return
    empty = QgsVectorLayer(f"Polygon?{EDITS_FIELDS}", "edits", "memory")
    empty.setCrs(QgsRasterLayer(terrain, "").crs())
    settings = QgsVectorFileWriter.SaveVectorOptions()
    settings.layerName = "edits"
    context = QgsProject.instance().transformContext()
    failed = QgsVectorFileWriter.writeAsVectorFormatV3(empty, str(path), context, settings)
    if failed[0] != QgsVectorFileWriter.WriterError.NoError:
        feedback.pushWarning(f"{path}: cannot be written: {failed[1]}")


def _add_clouds(
    folder: str, title: str, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> None:
    """Add the classified clouds as one layer, or report why this QGIS cannot show them."""
    path = existing(folder, "classified.vpc")
    if not path:
        return
    layer = _cloud(path, "clouds", "classified clouds", False)
    if layer is None:
        feedback.pushInfo(
            f"{path}: contains the classified clouds as one layer, which this QGIS ({Qgis.QGIS_VERSION}) cannot show; "
            "use QGIS 3.32 or newer"
        )
    else:
        _add(f"{folder}|clouds", folder, title, LOWEST, layer, context)


def _add(
    key: str, folder: str, title: str, rank: int, wanted: Wanted, context: QgsProcessingContext
) -> None:
    """Register a layer to be added when the algorithm ends, or reload it if the project already has it."""
    for layer in context.project().mapLayers().values():
        if layer.customProperty(KEY) == key:
            layer.dataProvider().reloadData()
            layer.triggerRepaint()
            return
    layer = wanted.make(wanted.name)
    if not layer.isValid():
        return
    layer.setCustomProperty(KEY, key)
    wanted.style(layer)
    context.temporaryLayerStore().addMapLayer(layer)
    details = QgsProcessingContext.LayerDetails(wanted.name, context.project())
    placer = _Placer(folder, title, rank, wanted.shown)
    _KEPT.append(placer)
    details.setPostProcessor(placer)
    context.addLayerToLoadOnCompletion(layer.id(), details)


class _Placer(QgsProcessingLayerPostProcessorInterface):
    """Post-processor that moves a layer into the group of its folder, at the position of its rank."""

    def __init__(self, folder: str, title: str, rank: int, shown: bool) -> None:
        super().__init__()
        self._folder, self._title, self._rank, self._shown = folder, title, rank, shown

    def postProcessLayer(
        self, layer: QgsMapLayer, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> None:
        """Move the layer within the tree of layers."""
        root = context.project().layerTreeRoot()
        node = root.findLayer(layer.id())
        if node is None:
            return
        if self._folder:
            group = _group_of(root, self._folder)
            if group is None:
                group = root.insertGroup(0, self._title)
                group.setCustomProperty(KEY, self._folder)
            ranks = [int(other.customProperty(RANK, -1)) for other in group.children()]
            moved = node.clone()
            moved.setCustomProperty(RANK, self._rank)
            group.insertChildNode(sum(rank < self._rank for rank in ranks), moved)
            node.parent().removeChildNode(node)
            node = moved
        node.setItemVisibilityChecked(self._shown)
        node.setExpanded(False)


def _group_of(root: Any, folder: str) -> Any:
    """Return the group with the results of a folder, or None if there is no such group yet."""
    return next(
        (group for group in root.findGroups() if group.customProperty(KEY) == folder), None
    )
