"""Section of the report about accuracy: measurements in OUT, and standard errors.

Measurements are the JSON files of `tiler check` and `tiler evaluate`. Standard errors are a rule of thumb for the RMSE
of the terrain, with a histogram.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tiler.core.products import COVERED, GROUPS, OPEN, WET
from tiler.core.units import short_unit
from tiler.core.words import counted
from tiler.errors import write_error
from tiler.io.atomic_files import write_atomic
from tiler.io.foreign_content import parse_json_object
from tiler.io.result_folder import CHECK, EVALUATION, raster_places
from tiler.redaction import shown, stored
from tiler.report.document import Content, Node, bar, el, facts, table
from tiler.report.pictures import open_raster
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.runfile import units_of

FIGURES = {
    "points": "points",
    "rmse_v": "RMSEV",
    "bias": "mean",
    "median": "median",
    "nmad": "NMAD",
    "p95_abs": "95 % within",
    "max_abs": "largest",
    "outliers": "outliers",
}

SPREAD = {
    "rmse": "RMSE",
    "bias": "mean",
    "median": "median",
    "nmad": "NMAD",
    "p95_abs": "95 % within",
}
"""Statistics of differences, and their names on the page."""

HOW = {
    "with checkpoints": "tiler check OUT --points FILE",
    "between flight strips": "tiler check OUT --strips OUT/classified",
    "with an earlier DTM": "tiler check OUT --against OLD.tif --difference FILE.tif",
    "with reference classes": "tiler evaluate CLOUD --reference REF --json > OUT/evaluate.json",
    "after tiler evaluate": "tiler report OUT",
}
"""Commands that write the files of the section, and when to use them."""


def read_measured(out: Path, name: str, run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file of ``OUT`` with measurements of a run, which is empty if the file does not exist.

    If tiler did not write the file, the content is an error under ``unreadable``.
    """
    path = out / name
    if not path.is_file():
        return {}
    try:
        measured = parse_json_object(path.read_text("utf-8"))
        checkpoints_on_map(measured)
        accuracy_content(*((measured, {}) if name == CHECK else ({}, measured)))
    except (OSError, ValueError) as error:
        return {"unreadable": f"{name}: {error}"}
    except (KeyError, TypeError, AttributeError, ArithmeticError) as error:
        fault = f"was not written by this version of tiler ({type(error).__name__}: {error}); measure again"
        return {"unreadable": f"{name}: {fault}"}
    dtms = [p for p in (out / file for file in raster_places(run, "dtm")) if p.is_file()]
    older = bool(dtms) and path.stat().st_mtime < max(p.stat().st_mtime for p in dtms)
    return {**measured, "older": older}


def write_measured(out: Path, name: str, content: Mapping[str, Any]) -> None:
    """Write measurements to the file that `read_measured` reads, or raise ProcessingError."""
    text = json.dumps(stored(content), indent=1, default=str) + "\n"
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(out / name, text.encode())
    except OSError as error:
        raise write_error(str(out / name), error, out) from error


def accuracy_content(check: Mapping[str, Any], evaluation: Mapping[str, Any]) -> list[Content]:
    """Return tables of the measurements, or the commands that make them if there are none."""
    content: list[Content] = []
    for name, measured in ((CHECK, check), (EVALUATION, evaluation)):
        if "unreadable" in measured:
            content.append(el("p", measured["unreadable"], class_="warning"))
        elif measured.get("older"):
            text = (
                f"{name} is older than the DTM, so it may describe another DTM; measure again."
            )
            content.append(el("p", text, class_="warning"))
    if check.get("accuracy"):
        content += _checkpoints(check["accuracy"])
    makers: dict[str, Callable[[Any], Node]] = {
        "seams": _seams,
        "strips": _strips,
        "against": _changes,
        "requirements": _requirements,
    }
    content += [make(check[name]) for name, make in makers.items() if check.get(name)]
    if "total" in evaluation:
        content.append(_classes(evaluation))
    if evaluation.get("dtm"):
        content.append(_true_dtm(evaluation["dtm"]))
    return content or [
        el("p", "Nothing was measured yet. These commands fill this section:"),
        facts({when: el("code", command) for when, command in HOW.items()}),
    ]


def statement_text(asprs: Mapping[str, Any]) -> str:
    """Return the accuracy statement by the ASPRS standards, or what it lacks."""
    lacks = "; ".join(asprs["missing"])
    return str(asprs["statement"] or f"no accuracy statement by the ASPRS standards: {lacks}")


SURE_ERRORS = 4
"""Number of standard errors from which a difference of means is a seam. Pairs beside each other are not independent, so
that the true error is some 1.5 to 2 times as large."""


def seams_text(seams: Mapping[str, Any]) -> str:
    """Return a sentence that says whether the DTM has seams at the edges of tiles.

    Means of rough terrain differ by chance, so a seam is an excess of more than 1 mm, of more than a quarter of the
    jumps next to the edges, and of more than `SURE_ERRORS` standard errors.
    """
    excess, unit = seams["excess"], seams["unit"]
    if excess is None:
        return "Seams were not compared: no edge of a tile has heights on both sides."
    across = seams["tiles"]["mean_jump"]
    near = across - excess
    means = f"mean jump {across:.4f} {unit}, next to them {near:.4f} {unit}"
    if excess <= near / 4 or excess * seams["metres_per_unit"] <= 0.001:
        degree = "not" if excess <= 0 else "hardly"
        return f"No seam: steps at tile edges are {degree} larger than next to them ({means})."
    error = seams.get("excess_error")
    if error is None or excess <= SURE_ERRORS * error:
        return (
            f"Not sure: steps at tile edges are larger by {excess:.4f} {unit} than next to them ({means}), but "
            f"{counted(seams['tiles']['pairs'], 'pair')} of pixels may give that by chance."
        )
    return f"Seams: steps at tile edges are larger by {excess:.4f} {unit} than next to them ({means})."


CHANGE_HEADINGS = ("west, south", "east, north", "area m2", "mean m", "largest m", "volume m3")
"""Columns of a table of places of change."""


def changes_text(against: Mapping[str, Any]) -> str:
    """Return a sentence about the changes since an earlier DTM."""
    limit, changed, pixels = (
        against["change_m"],
        against["changed_pixels"],
        against["all"]["pixels"],
    )
    text = (
        f"{_percent(changed / pixels)} of {counted(pixels, 'pixel')} changed by {limit:g} m or more, "
        f"in {counted(against['number_of_places'], 'place')}"
    )
    if against["scattered_pixels"]:
        text += f", {counted(against['scattered_pixels'], 'pixel')} of them scattered between places"
    if against["only_new"]:
        text += f"; {counted(against['only_new'], 'pixel')} had no earlier height"
    if against["only_old"]:
        text += f"; {counted(against['only_old'], 'pixel')} lost their height"
    return text + "."


def groups_of(against: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the figures of all changes, by slope and by source of the new height."""
    by_source = {name.partition(":")[0]: found for name, found in against["by_source"].items()}
    return {"all": against["all"], **against["by_slope"], **by_source}


def places_of(against: Mapping[str, Any], number: int) -> list[tuple[str, ...]]:
    """Return rows of `CHANGE_HEADINGS` for the first places of change."""
    return [
        (
            "{:.0f}, {:.0f}".format(*place["bounds"][:2]),
            "{:.0f}, {:.0f}".format(*place["bounds"][2:]),
            f"{place['area_m2']:,.0f}",
            f"{place['mean_m']:.2f}",
            f"{place['largest_m']:.2f}",
            f"{place['volume_m3']:,.0f}",
        )
        for place in against["places"][:number]
    ]


def groups_at(accuracy: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the figures of the checkpoints by type, of all, and by land cover, which may have the name of a type."""
    kinds = ("nva", "vva", "all")
    found = [(kind.upper(), accuracy[kind]) for kind in kinds if accuracy[kind]["points"]]
    return [*found, *accuracy["land_cover"].items()]


def checkpoints_on_map(check: Mapping[str, Any]) -> dict[str, Any]:
    """Return the checkpoints for the map, each with name, x, y, difference, and whether it is an outlier."""
    accuracy = check.get("accuracy") or {}
    number_keys = ("x", "y", "difference")
    return {
        "checkpoints": [
            [
                shown(str(p["name"])),
                *(_finite(p[key]) for key in number_keys),
                bool(p["outlier"]),
            ]
            for p in accuracy.get("differences", ())
        ],
        "checkpoint_unit": str(accuracy.get("unit", "")),
        "checkpoint_range": _finite((accuracy.get("all") or {}).get("p95_abs")) or 1.0,
    }


def _finite(value: Any) -> float | None:
    """Return a finite number or None, or raise ValueError for other values."""
    if value is None:
        return None
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    return float(value)


def _number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.2f} %"


def _checkpoints(found: Mapping[str, Any]) -> list[Content]:
    rows = [
        (name, *(_number(values[key]) for key in FIGURES)) for name, values in groups_at(found)
    ]
    offset = found["constant_offset"]
    return [
        el("h3", f"Checkpoints: DTM minus checkpoint, {found['unit']}"),
        table(("", *FIGURES.values()), rows, range(1, len(FIGURES) + 1)),
        *([el("p", _capitalized(offset), class_="warning")] if offset else ()),
        el("p", _capitalized(statement_text(found["asprs"]))),
        *(el("p", note, class_="quiet") for note in found["notes"]),
    ]


def _capitalized(text: str) -> str:
    return text[:1].upper() + text[1:]


def _seams(found: Mapping[str, Any]) -> Node:
    keys = {"pairs": "pairs", "mean_step": "mean step", "largest_step": "largest step"}
    rows = [
        (name.replace("_", " "), *(_number(found[name].get(key), 4) for key in keys))
        for name in ("tiles", "beside_tiles", "blocks", "beside_blocks", "interior")
        if name in found
    ]
    heading = el("h3", f"Steps between pixels across the edges of tiles, {found['unit']}")
    steps = table(("position", *keys.values()), rows, (1, 2, 3))
    return el("div", heading, steps, el("p", seams_text(found)))


def _strips(found: Mapping[str, Any]) -> Node:
    heading = el("h3", f"Second minus first flight strip, {found['unit']}")
    groups = [("all", found["cells"], found["all"])]
    groups += [
        (f"{pair['second']} - {pair['first']}", pair["cells"], pair) for pair in found["pairs"]
    ]
    if len(groups) == 1:
        lines = counted(len(found["strips"]), "flight line")
        none = f"The points have {lines} (by point source id), and no cell has points of two."
        return el("div", heading, el("p", none))
    rows = [
        (name, _number(cells), *(_number(values[key]) for key in SPREAD))
        for name, cells, values in groups[: MAX_ROWS + 1]
    ]
    names = (f"strips, in cells of {found['cell_m']:g} m", "cells", *SPREAD.values())
    return el("div", heading, table(names, rows, range(1, len(names))))


def _changes(found: Mapping[str, Any]) -> Node:
    heading = el("h3", f"Changes since {shown(found['old'])}, {found['unit']}")
    rows = [
        (name, _number(values["pixels"]), *(_number(values[key]) for key in SPREAD))
        for name, values in groups_of(found).items()
    ]
    figures = table(("pixels of", "number", *SPREAD.values()), rows, range(1, len(SPREAD) + 2))
    places = table(CHANGE_HEADINGS, places_of(found, MAX_ROWS), range(len(CHANGE_HEADINGS)))
    notes = (el("p", note, class_="quiet") for note in found["notes"])
    return el("div", heading, figures, el("p", changes_text(found)), places, *notes)


def _requirements(found: list[Mapping[str, Any]]) -> Node:
    rows = [
        (
            r["name"],
            f"{r['limit']:g} {r.get('unit', '')}",
            _number(r["value"], 4),
            el("strong", "met" if r["met"] else "NOT met"),
        )
        for r in found
    ]
    return el(
        "div", el("h3", "Required"), table(("figure", "limit", "measured", ""), rows, (1, 2))
    )


def _classes(found: Mapping[str, Any]) -> Node:
    pairs: dict[str, Content] = {
        "type I, ground lost": _percent(found["type_1"]),
        "type II, objects classified as ground": _percent(found["type_2"]),
        "total error": f"{_percent(found['total'])} of {found['points']:,} points",
        "Cohen's kappa": _percent(found["kappa"]),
    }
    return el("div", el("h3", "Classes against the reference"), facts(pairs))


def _true_dtm(found: Mapping[str, Any]) -> Node:
    unit = found["unit"]
    pairs: dict[str, Content] = {
        text: f"{_number(found[key])} {unit}"
        for key, text in SPREAD.items()
        if found.get(key) is not None
    }
    pairs["pixels"] = _number(found["pixels"])
    return el("div", el("h3", "DTM against the reference"), facts(pairs))


CALIBRATED = {
    "lidar": "27 LiDAR clouds whose terrain is known, 14 simulated and 13 real ones with classified ground",
    "dim": "21 photogrammetric clouds whose terrain is known, 14 simulated and 7 made from real surfaces",
}
"""Scenes to which the constants of each kind of cloud were fitted."""
UNKNOWN = "both LiDAR and photogrammetric clouds (the larger error counts, because the kind of this cloud is unknown)"
NAMES = {
    OPEN: "open ground",
    COVERED: "covered ground: half of the nearby points are objects, or the terrain is bridged or filled",
    WET: "water",
}
BAR_WIDTH = 300
FEW = 20
"""Number of checkpoints below which their scale is uncertain by more than a sixth."""


class AtCheckpoints(NamedTuple):
    """RMSE at checkpoints, measured and by the rule of thumb, in units of the heights. ``expected`` may be unknown."""

    points: int
    measured: float
    expected: float | None


def at_checkpoints(
    check: Mapping[str, Any], rasters: Mapping[str, str]
) -> AtCheckpoints | None:
    """Return the RMSE at the checkpoints of check.json, or None if it has none on this terrain.

    Parameters
    ----------
    check : mapping
        Result of `read_measured`.
    rasters : mapping of str to str
        Path or URL of each raster by product. The rule of thumb is known where ``sigma`` has values.
    """
    accuracy = {} if check.get("older") else check.get("accuracy") or {}
    measured = [p for p in accuracy.get("differences", ()) if p["difference"] is not None]
    if not measured:
        return None
    both = []
    if "sigma" in rasters:
        with open_raster(rasters["sigma"]) as raster:
            sampled = raster.sample([(p["x"], p["y"]) for p in measured], masked=True)
            values = [None if v.mask.any() else float(v[0]) for v in sampled]
        both = [
            (p["difference"], v)
            for p, v in zip(measured, values, strict=True)
            if v is not None and 0 < v < math.inf
        ]
    if not both:
        return AtCheckpoints(
            len(measured), _root_mean_square([p["difference"] for p in measured]), None
        )
    differences, errors = zip(*both, strict=True)
    return AtCheckpoints(len(both), _root_mean_square(differences), _root_mean_square(errors))


def _root_mean_square(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values))


def rule_of_thumb(run: Run, checked: AtCheckpoints | None = None) -> list[Content]:
    """Return a table of the RMSE that the standard errors give, or an empty list if the run made none.

    With checkpoints, the rule of thumb is also given multiplied by the ratio of their RMSE to it.
    """
    sigma = run.get("sigma")
    if not sigma:
        return []
    unit_m = units_of(run)[1]
    unit = short_unit(unit_m)
    pixels = max(sum(sigma[name]["pixels"] for name in GROUPS), 1)
    ratio = checked.measured / checked.expected if checked and checked.expected else None
    rows = [
        (
            NAMES[name],
            f"{sigma[name]['pixels'] / pixels:.1%}",
            f"{sigma[name]['rmse_m'] / unit_m:.3f}",
            *(() if ratio is None else (f"{ratio * sigma[name]['rmse_m'] / unit_m:.3f}",)),
        )
        for name in GROUPS
        if sigma[name]["pixels"]
    ]
    scaled = () if ratio is None else ("scaled by checkpoints",)
    basis = CALIBRATED.get(sigma["kind"] or "", UNKNOWN)
    text = (
        "A rule of thumb, not a measurement: it is estimated without checkpoints, with constants fitted to "
        f"{basis}. For scenes that were left out of the fit, "
        "the actual RMSE was within a factor of 2 in four of five LiDAR clouds and nine of ten photogrammetric clouds. "
        "The estimate does not include errors that all strips share. It can be too small where a smooth surface is "
        "wrong, such as a roof classified as ground."
    )
    return [
        el("h3", f"Rule of thumb for the RMSE of this terrain, {unit}"),
        table(("ground", "share of the pixels", "rule of thumb", *scaled), rows, (1, 2, 3)),
        *([] if checked is None else [el("p", _checked_text(checked, ratio, unit))]),
        el("p", text),
    ]


def standard_errors(run: Run) -> list[Content]:
    """Return a histogram of the standard errors, or an empty list if the run made none."""
    if not run.get("sigma"):
        return []
    unit_m = units_of(run)[1]
    columns = (f"standard error, {short_unit(unit_m)}", "pixels", "")
    return [table(columns, _histogram(run["sigma"], unit_m), (1,))]


def _checked_text(checked: AtCheckpoints, ratio: float | None, unit: str) -> str:
    at = f"At {counted(checked.points, 'checkpoint')} the measured RMSE is {checked.measured:.3f} {unit}"
    if ratio is None:
        return f"{at}. The rule of thumb is not known there, so it is not scaled."
    few = " The ratio of so few checkpoints is uncertain." if checked.points < FEW else ""
    return (
        f"{at}, and the rule of thumb gives {checked.expected:.3f} {unit}: the last column is the rule of thumb "
        f"times {ratio:.2f}.{few} Checkpoints on open ground say little about covered ground."
    )


def _histogram(found: Mapping[str, Any], unit_m: float) -> list[tuple[Content, ...]]:
    """Return a row with a bar for each class of standard errors, without empty classes at either end."""
    counts = [
        sum(both) for both in zip(*(found[name]["histogram"] for name in GROUPS), strict=True)
    ]
    there = [i for i, n in enumerate(counts) if n]
    if not there:
        return []
    edges, most = found["edges_m"], max(counts)
    ends = [*(f"to {edge / unit_m:.2f}" for edge in edges[1 : len(counts)]), "and more"]
    return [
        (
            f"{edges[i] / unit_m:.2f} {ends[i]}",
            f"{counts[i]:,}",
            bar(counts[i] / most, BAR_WIDTH),
        )
        for i in range(there[0], there[-1] + 1)
    ]
