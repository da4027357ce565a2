"""Styles of the result layers, and forms of the layers that users edit."""

from __future__ import annotations

from typing import Any

from qgis.core import (
    QgsCategorizedSymbolRenderer,
    QgsColorRampShader,
    QgsDefaultValue,
    QgsEditorWidgetSetup,
    QgsFillSymbol,
    QgsGradientColorRamp,
    QgsGradientStop,
    QgsHillshadeRenderer,
    QgsLineSymbol,
    QgsMarkerSymbol,
    QgsPalettedRasterRenderer,
    QgsPalLayerSettings,
    QgsPointCloudClassifiedRenderer,
    QgsRasterShader,
    QgsRendererCategory,
    QgsRuleBasedLabeling,
    QgsSingleBandGrayRenderer,
    QgsSingleBandPseudoColorRenderer,
    QgsSingleSymbolRenderer,
    QgsTextBufferSettings,
    QgsTextFormat,
)
from qgis.PyQt.QtGui import QColor, QPainter

from .process import TABLE

GREEN_TO_WHITE = (
    (0.0, "#5b8c5a"),
    (0.25, "#a9bf7a"),
    (0.5, "#e8dca0"),
    (0.75, "#b98b5e"),
    (1.0, "#f4f1ee"),
)
"""Colours of heights from low to high."""
ACTIONS = {
    "not_ground": ("not_ground: no point inside is ground", "#d1495b"),
    "ground": ("ground: the points inside are ground", "#8a5a2b"),
    "void": ("void: no height inside", "#555555"),
    "flat": ("flat: the terrain inside has the height in column z", "#2a6f97"),
}
WATERS = (
    "lake",
    "pond",
    "reservoir",
    "basin",
    "sea",
    "lagoon",
    "river",
    "stream",
    "canal",
    "ditch",
)
CUT = 0.01
"""Share of the lowest and of the highest heights that get the first and the last colour."""
BRIGHTER = 50
"""Brightness added to a hillshade, 0 to 255, so that flat ground nearly keeps its colour."""
MIN_RANGE = 1e-3
SAMPLE_PIXELS = 300
"""Side, in pixels, of the sample that decides the range of heights."""


def heights(layer: Any) -> None:
    """Style heights with colours from low to high, below the hillshade."""
    provider = layer.dataProvider()
    low, high = _range(layer)
    stops = [QgsGradientStop(at, QColor(colour)) for at, colour in GREEN_TO_WHITE[1:-1]]
    ramp = QgsGradientColorRamp(
        QColor(GREEN_TO_WHITE[0][1]), QColor(GREEN_TO_WHITE[-1][1]), False, stops
    )
    function = QgsColorRampShader(
        low,
        high,
        ramp,
        QgsColorRampShader.Type.Interpolated,
        QgsColorRampShader.ClassificationMode.Continuous,
    )
    function.classifyColorRamp(5, 1, layer.extent(), provider)
    shader = QgsRasterShader()
    shader.setRasterShaderFunction(function)
    renderer = QgsSingleBandPseudoColorRenderer(provider, 1, shader)
    renderer.setClassificationMin(low)
    renderer.setClassificationMax(high)
    layer.setRenderer(renderer)


def _range(layer: Any) -> tuple[float, float]:
    """Return the lowest and highest height of the colour ramp.

    They come from a sample of pixels. GDAL would store its statistics in a file next to the
    raster, and use them even after the raster has changed.
    """
    block = layer.dataProvider().block(1, layer.extent(), SAMPLE_PIXELS, SAMPLE_PIXELS)
    pixel_numbers = range(block.width() * block.height())
    values = sorted(block.value(i) for i in pixel_numbers if not block.isNoData(i))
    if not values:
        return 0.0, 1.0
    low, high = values[int(CUT * len(values))], values[int((1 - CUT) * len(values))]
    return low, max(high, low + MIN_RANGE)


def shade(layer: Any) -> None:
    """Style the terrain as a hillshade that darkens the layers below it."""
    renderer = QgsHillshadeRenderer(layer.dataProvider(), 1, 315.0, 45.0)
    renderer.setMultiDirectional(True)
    _darken(layer, renderer)


def grey_shade(layer: Any) -> None:
    """Style a hillshade that was written as a file."""
    _darken(layer, QgsSingleBandGrayRenderer(layer.dataProvider(), 1))


def _darken(layer: Any, renderer: Any) -> None:
    """Draw a hillshade so that it darkens the layers below it."""
    layer.setRenderer(renderer)
    layer.brightnessFilter().setBrightness(BRIGHTER)
    layer.setBlendMode(QPainter.CompositionMode.CompositionMode_Multiply)


def mask(layer: Any) -> None:
    """Style the classes with their colours and names. Pixels outside are transparent."""
    classes = [
        QgsPalettedRasterRenderer.Class(
            entry["value"],
            QColor(*entry["colour"], 255 if entry["value"] else 0),
            entry["label"],
        )
        for entry in TABLE["mask"]
    ]
    layer.setRenderer(QgsPalettedRasterRenderer(layer.dataProvider(), 1, classes))


def cloud(layer: Any) -> None:
    """Style points by class."""
    renderer = QgsPointCloudClassifiedRenderer()
    renderer.setAttribute("Classification")
    renderer.setCategories(QgsPointCloudClassifiedRenderer.defaultCategories())
    layer.setRenderer(renderer)


def as_in_file(layer: Any) -> None:
    """Keep the style and the form that QGIS read from the file."""


def outline(layer: Any) -> None:
    """Style the outline as a dashed line without a fill."""
    _fill(layer, "0,0,0,0", "#222222", "0.5", outline_style="dash")


def bridges(layer: Any) -> None:
    """Style bridges in red, because they are not in the terrain."""
    _fill(layer, "209,73,91,60", "#d1495b", "0.4")


def water(layer: Any) -> None:
    """Style water in blue, and offer its kinds as a list in the form."""
    _fill(layer, "70,130,200,120", "#2a6f97", "0.3")
    _list(layer, "kind", {kind: kind for kind in WATERS})


def _fill(layer: Any, inside: str, line: str, width: str, **more: str) -> None:
    style = {"color": inside, "outline_color": line, "outline_width": width, **more}
    layer.setRenderer(QgsSingleSymbolRenderer(QgsFillSymbol.createSimple(style)))


def flow(layer: Any) -> None:
    """Style the lines along the middle of rivers."""
    line = QgsLineSymbol.createSimple({"color": "#1d4e89", "width": "0.4"})
    layer.setRenderer(QgsSingleSymbolRenderer(line))


def contours(layer: Any) -> None:
    """Style contours, with thicker index contours that are labelled with their height."""
    thin, strong = ({"color": "#7a5c3a", "width": width} for width in ("0.15", "0.4"))
    categories = [
        QgsRendererCategory(value, QgsLineSymbol.createSimple(style), label)
        for value, style, label in ((True, strong, "index"), (False, thin, "contour"))
    ]
    layer.setRenderer(QgsCategorizedSymbolRenderer("index", categories))
    _label(layer, "elevation", '"index"', QgsPalLayerSettings.Placement.Curved)


def spots(layer: Any) -> None:
    """Style spot heights as dots with their height."""
    dot = {"name": "circle", "size": "1.2", "color": "#222222", "outline_style": "no"}
    layer.setRenderer(QgsSingleSymbolRenderer(QgsMarkerSymbol.createSimple(dot)))
    _label(layer, "elevation", "", QgsPalLayerSettings.Placement.OrderedPositionsAroundPoint)


def edits(layer: Any) -> None:
    """Style edits by action. The form offers the actions as a list and explains z."""
    categories = []
    for action, (label, colour) in ACTIONS.items():
        inside = ",".join(str(part) for part in QColor(colour).getRgb()[:3])
        style = {"color": f"{inside},70", "outline_color": colour, "outline_width": "0.5"}
        categories.append(QgsRendererCategory(action, QgsFillSymbol.createSimple(style), label))
    layer.setRenderer(QgsCategorizedSymbolRenderer("action", categories))
    _list(layer, "action", {label: action for action, (label, _) in ACTIONS.items()})
    if (field_index := layer.fields().indexOf("action")) >= 0:
        layer.setDefaultValueDefinition(field_index, QgsDefaultValue("'not_ground'"))
    if (field_index := layer.fields().indexOf("z")) >= 0:
        layer.setFieldAlias(field_index, "z: height (only for flat)")
    if (field_index := layer.fields().indexOf("fid")) >= 0:
        layer.setEditorWidgetSetup(field_index, QgsEditorWidgetSetup("Hidden", {}))


def _list(layer: Any, name: str, values: dict[str, str]) -> None:
    """Offer the values of a column as a list in the form."""
    field_index = layer.fields().indexOf(name)
    if field_index >= 0:
        entries = [{label: value} for label, value in values.items()]
        layer.setEditorWidgetSetup(
            field_index, QgsEditorWidgetSetup("ValueMap", {"map": entries})
        )


def _label(layer: Any, column: str, filter: str, placement: Any) -> None:
    settings = QgsPalLayerSettings()
    written = (
        layer.fields().indexOf("label") >= 0
    )  # The column has equal decimals in all features. Older files lack it.
    settings.fieldName = '"label"' if written else f'round("{column}", 2)'
    settings.isExpression = True
    settings.placement = placement
    text, halo = QgsTextFormat(), QgsTextBufferSettings()
    text.setSize(8)
    text.setColor(QColor("#4a3520"))
    halo.setEnabled(True)
    halo.setSize(0.7)
    text.setBuffer(halo)
    settings.setFormat(text)
    rule = QgsRuleBasedLabeling.Rule(settings)
    if filter:
        rule.setFilterExpression(filter)
    root = QgsRuleBasedLabeling.Rule(None)
    root.appendChild(rule)
    layer.setLabeling(QgsRuleBasedLabeling(root))
    layer.setLabelsEnabled(True)
