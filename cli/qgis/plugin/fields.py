"""Parameters of an algorithm: their definitions, made from the table, and their values."""

from __future__ import annotations

from typing import Any

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterMultipleLayers,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
)

from .process import TABLE, absolute

FOLDER = "FOLDER"
"""Name of the parameter that can replace the files of ``INPUT``."""
ALL_FILES = "All files (*)"


def make_parameters(spec: dict[str, Any]) -> list[Any]:
    """Return the parameters of QGIS for an entry of the table."""
    made = [_parameter(spec)]
    if spec["kind"] == "clouds":
        label = "... or a folder (all clouds in it and in its subfolders)"
        made.append(
            QgsProcessingParameterFile(
                FOLDER,
                label,
                behavior=QgsProcessingParameterFile.Behavior.Folder,
                optional=True,
            )
        )
    if spec["kind"] in ("clouds", "files"):
        filter = TABLE["cloud_files"] if spec["kind"] == "clouds" else ALL_FILES
        wrapper = {"class": f"{__package__}.widgets.FilesWrapper", "filter": filter}
        made[0].setMetadata({"widget_wrapper": wrapper})
    for parameter in made:
        parameter.setHelp(spec["help"])
        if spec["advanced"]:
            parameter.setFlags(
                parameter.flags() | QgsProcessingParameterDefinition.Flag.FlagAdvanced
            )
    return made


def _parameter(spec: dict[str, Any]) -> Any:
    name, kind, default = spec["name"], spec["kind"], spec["default"]
    optional = default is None and not spec["required"]
    label = spec["label"] + (f" [{spec['unit']}]" if spec["unit"] else "")
    if kind in ("clouds", "files"):
        return QgsProcessingParameterMultipleLayers(
            name, label, QgsProcessing.SourceType.TypeFile, optional=True
        )
    if kind in ("cloud", "file"):
        filter = TABLE["cloud_files"] if kind == "cloud" else ALL_FILES
        optional = not spec[
            "required"
            # A setting with a default is optional, too, because QGIS does not accept the default as
            # a file.
        ]
        return QgsProcessingParameterFile(
            name, label, defaultValue=default, optional=optional, fileFilter=filter
        )
    if kind in ("new_folder", "new_plots"):
        # A FolderDestination would offer a temporary folder, in which a stopped job cannot
        # resume.
        return QgsProcessingParameterFile(
            name, label, behavior=QgsProcessingParameterFile.Behavior.Folder, optional=optional
        )
    if kind in ("new_picture", "new_cloud"):
        filter = "PNG (*.png)" if kind == "new_picture" else "LAZ (*.laz);;LAS (*.las)"
        return QgsProcessingParameterFileDestination(name, label, filter)
    if kind == "raster":
        return QgsProcessingParameterRasterLayer(name, label, optional=optional)
    if kind == "choice":
        return QgsProcessingParameterEnum(
            name, label, spec["choices"], False, default, optional, usesStaticStrings=True
        )
    if (
        kind == "names"
        # The values are numbers, because the dialog of QGIS 3.22 loses names if several are given.
    ):
        return QgsProcessingParameterEnum(
            name, label, spec["choices"], True, numbers_of_names(spec, default), optional
        )
    if kind == "flag":
        return QgsProcessingParameterBoolean(name, label, default)
    if kind == "int":
        number = QgsProcessingParameterNumber(
            name,
            label,
            QgsProcessingParameterNumber.Type.Integer,
            default,
            optional=optional or default is None,
        )
        for limit, put in (("minimum", number.setMinimum), ("maximum", number.setMaximum)):
            if spec.get(limit) is not None:
                put(spec[limit])
        return number
    if kind == "bounds":
        return QgsProcessingParameterExtent(name, label, optional=True)
    return QgsProcessingParameterString(name, label, default, optional=optional)


def numbers_of_names(spec: dict[str, Any], value: Any) -> Any:
    """Return the positions of choices, given as names or numbers in a list or separated by commas.

    Other items are returned unchanged.
    """
    value = value.split(",") if isinstance(value, str) else value
    items = value if isinstance(value, (list, tuple)) else [value]
    choices = spec["choices"]
    resolved = [choices.index(item) if item in choices else item for item in items]
    return [int(item) if str(item).isdecimal() else item for item in resolved]


def read_value(
    algorithm: QgsProcessingAlgorithm,
    spec: dict[str, Any],
    parameters: dict[str, Any],
    context: QgsProcessingContext,
) -> Any:
    """Return the value of a parameter in plain Python types, with absolute paths, or None if it is not given.

    It does not read parameters of extents.
    """
    name, kind = spec["name"], spec["kind"]
    given = parameters.get(name) is not None
    if kind in ("new_picture", "new_cloud"):
        path = algorithm.parameterAsFileOutput(parameters, name, context)
        return absolute(path) if given else path
    if not given:  # The command has the same defaults as the parameters.
        return None
    if kind in ("clouds", "files"):
        paths = algorithm.parameterAsFileList(parameters, name, context)
        return [absolute(str(path)) for path in paths if path]
    if kind in ("cloud", "new_folder", "new_plots"):
        return absolute(algorithm.parameterAsFile(parameters, name, context))
    if kind == "file":
        text = algorithm.parameterAsFile(parameters, name, context)
        return text if text in ("", "none", "auto") else absolute(text)
    if kind == "raster":
        layer = algorithm.parameterAsRasterLayer(parameters, name, context)
        return absolute(layer.source() if layer is not None else str(parameters[name]))
    if kind == "names":
        return [spec["choices"][number] for number in numbers_of_names(spec, parameters[name])]
    if kind == "choice":
        return algorithm.parameterAsEnumString(parameters, name, context)
    if kind == "flag":
        return algorithm.parameterAsBool(parameters, name, context)
    if kind == "int":
        return algorithm.parameterAsInt(parameters, name, context)
    text = algorithm.parameterAsString(parameters, name, context).strip()
    return text.split() if kind == "texts" else text
