"""The scorecard's cells as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import mean, median
from typing import TYPE_CHECKING

from tests.benchmarks.published import MEANS, PER_SAMPLE, RMSES
from tests.benchmarks.scorecard_scenes import RAW, SEMI_REAL

if TYPE_CHECKING:
    from tests.benchmarks.leave_one_out import LeaveOneOut
    from tests.benchmarks.measuring import Cell

HEAD = """# Scorecard

Every filter has its defaults, one setting for all scenes, and is compared with reference classes that it does not
read. Class 2 is ground. All other classes are objects, except those that do not count: noise (7, 18), water (9),
bridges (17, 26), a producer's virtual points and artefacts (64 to 67). Type I: ground that was lost. Type II: objects
classified as ground. Total: both, of all points. Kappa: Cohen's. All values are in percent.

`python tests/benchmarks/scorecard.py docs/scorecard.md` makes this page, with compiled kernels on one pinned core.
Times are CPU times of the fastest of {repeats} runs, from points in memory to labels in memory. Memory is the peak of
a run above its input. DTMs are the linear TIN of the points classified as ground, without smoothing. In
photogrammetric clouds, the DTM of `tiler run` is better
([benchmarks](benchmarks.md#image-matching-beside-other-programs)).

The trees of the last look of `auto` were fitted to the semi-real scenes, so its figures there are too good. With each
scene left out of the fit in turn, the mean total error is 1.85 % ([filters](filters.md)).

Other filters (`peer`) are run on photogrammetric clouds if they are installed. For laser scans see the
[benchmarks](benchmarks.md#laser-scans-beside-other-programs) and the published figures. They are not timed. `floor`
is not a filter but a limit. It has the errors if exactly the points nearer to the reference terrain than one height
are ground, with the best height for the scene, and the DTM of the reference ground points. Most of these errors in
simulated photogrammetric scenes are plants of 0.15 to 0.4 m that cover whole patches. Their tops are the surface of
the cloud, and the simulator calls them objects.
"""


ERRORS = "Type I / type II / total / kappa"


def markdown(
    cells: Sequence[Cell],
    reference: str,
    repeats: int,
    chosen: Mapping[str, LeaveOneOut] | None = None,
    missing: Mapping[str, str] | None = None,
) -> str:
    """The whole document.

    Parameters
    ----------
    cells : sequence of Cell
    reference : str
        The method whose time the others' are compared with.
    repeats : int
        Timed runs of each.
    chosen : mapping of LeaveOneOut, optional
        `auto` chosen on all scenes of a family but one, by family.
    missing : mapping, optional
        Peers that took no part, and why.
    """
    families = list(dict.fromkeys(cell.family for cell in cells))
    parts = [
        HEAD.format(repeats=repeats),
        "## Means over the scenes of a class\n",
        _means(cells, families),
        "## Overlap and correlation\n",
        _overlap(cells, families),
    ]
    for group in dict.fromkeys(cell.group for cell in cells):
        parts += [f"## {_capital(group)}\n", _scenes([c for c in cells if c.group == group])]
    raw = [cell for cell in cells if cell.family == RAW]
    if raw:
        parts += ["## Low points of raw laser scans\n", _low_points(raw)]
    parts += ["## Speed and memory\n", _speed(cells, reference)]
    for family, found in (chosen or {}).items():
        parts += [f"## `auto`, chosen on all but one: {family}\n", chosen_without(found)]
    refusals = {(c.method, c.refusal): c for c in cells if c.refusal is not None}
    if refusals:
        parts += ["## What refused, and why\n", _refusals(cells)]
    if missing:
        absent = "".join(f"- {name}: {why}\n" for name, why in missing.items())
        parts += ["## Other programs that took no part\n", absent]
    parts += ["## Published figures\n", _published()]
    return "\n".join(parts)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column left, the others right."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def percent(value: float | None) -> str:
    """A fraction in percent."""
    return "-" if value is None else f"{100 * value:.2f}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _methods(cells: Sequence[Cell]) -> list[str]:
    return list(dict.fromkeys(cell.method for cell in cells))


def _mean(cells: Sequence[Cell], key: str) -> float | None:
    """The mean of a figure over cells that have it; None unless all scenes gave a result."""
    if not cells or any(cell.refusal is not None for cell in cells):
        return None
    values = [value for cell in cells if (value := getattr(cell, key)) is not None]
    return mean(values) if values else None


def _means(cells: Sequence[Cell], families: Sequence[str]) -> str:
    """Mean errors of each method in each class, and over all; the lowest total in bold."""
    simulated = [c for c in cells if c.group.startswith("simulated")]
    rows = [_mean_row(cells, f, [c for c in cells if c.family == f]) for f in families]
    if simulated:
        real = [c for c in cells if c not in simulated and c.group != SEMI_REAL]
        rows += [
            _mean_row(cells, name, own)
            for name, own in (("all real", real), ("all simulated", simulated))
            if own
        ]
    rows.append(_mean_row(cells, "all", cells))
    note = (
        f"{ERRORS}, and the RMSE of the DTM where it is known everywhere; each scene has the same weight, the lowest "
        "total of a class is bold.\n\n"
    )
    return note + table(["class (scenes)", *_methods(cells)], rows)


def _mean_row(cells: Sequence[Cell], name: str, own: Sequence[Cell]) -> list[str]:
    by_method = {m: [c for c in own if c.method == m] for m in _methods(cells)}
    scenes = len({c.scene for c in own})
    by_method = {m: some if len(some) == scenes else [] for m, some in by_method.items()}
    totals = {
        m: total for m, some in by_method.items() if (total := _mean(some, "total")) is not None
    }
    best = min((total for m, total in totals.items() if m != "floor"), default=None)
    row = [f"{name} ({scenes})"]
    for method, some in by_method.items():
        if not some:
            row.append("-")
            continue
        refused = sum(c.refusal is not None for c in some)
        if refused:
            row.append(f"refused {refused} of {len(some)}")
            continue
        figures = [percent(_mean(some, key)) for key in ("type_1", "type_2", "total", "kappa")]
        if totals.get(method) == best and method != "floor":
            figures[2] = f"**{figures[2]}**"
        rmse = (
            _mean(some, "dtm_rmse_m") if all(c.dtm_rmse_m is not None for c in some) else None
        )
        row.append(" / ".join(figures) + ("" if rmse is None else f", {rmse:.3f} m"))
    return row


def _overlap(cells: Sequence[Cell], families: Sequence[str]) -> str:
    """Mean IoU and MCC of each method in each class."""
    rows = []
    for family in families:
        figures = []
        for method in _methods(cells):
            own = [c for c in cells if (c.method, c.family) == (method, family)]
            figures.append(f"{percent(_mean(own, 'iou'))} / {percent(_mean(own, 'mcc'))}")
        rows.append([family, *figures])
    note = "IoU / MCC: intersection over union of ground, and correlation of both classes (Matthews).\n\n"
    return note + table(["class", *_methods(cells)], rows)


def _scenes(cells: Sequence[Cell]) -> str:
    """Every scene of a group."""
    methods = _methods(cells)
    rows = []
    for scene in dict.fromkeys(cell.scene for cell in cells):
        own = {c.method: c for c in cells if c.scene == scene}
        first = next(iter(own.values()))
        of = (
            ""
            if first.family == first.group
            else f" ({first.family.removeprefix('simulated ')})"
        )
        rows.append(
            [f"{scene}{of}, {first.points:,} points", *(_cell(own.get(m)) for m in methods)]
        )
    known = any(cell.dtm_rmse_m is not None for cell in cells)
    note = (
        ERRORS
        + (", RMSE of the DTM at pixels of 1 m (0.5 m: semi-real)" if known else "")
        + ".\n\n"
    )
    return note + table(["scene", *methods], rows)


def _low_points(cells: Sequence[Cell]) -> str:
    """Return what became of the low points of each scene."""
    methods = _methods(cells)
    rows = []
    for scene in dict.fromkeys(cell.scene for cell in cells):
        own = {c.method: c for c in cells if c.scene == scene}
        shares = [
            f"{percent(own[m].low_found)} / {percent(own[m].low_as_ground)}"
            if m in own
            else "-"
            for m in methods
        ]
        rows.append([scene, *shares])
    note = (
        "Share of the points far below the ground (reference class 7) that is classified as low noise / as ground, in "
        "percent. The others are unclassified. Filters do not read that class.\n\n"
    )
    return note + table(["scene", *methods], rows)


def _cell(cell: Cell | None) -> str:
    if cell is None:
        return "-"
    if cell.refusal is not None:
        return "refused"
    text = " / ".join(percent(v) for v in (cell.type_1, cell.type_2, cell.total, cell.kappa))
    return text if cell.dtm_rmse_m is None else f"{text}, {cell.dtm_rmse_m:.3f} m"


def _speed(cells: Sequence[Cell], reference: str) -> str:
    """Return medians of points per second, time over that of the reference, and bytes per point."""
    own_time = {c.scene: c.seconds for c in cells if c.method == reference}
    kinds: tuple[tuple[str, Callable[[Cell], float | None]], ...] = (
        ("M points/s", lambda c: c.points / c.seconds / 1e6 if c.seconds else None),
        (f"x time of {reference}", lambda c: _over(c.seconds, own_time.get(c.scene))),
        ("bytes per point", lambda c: _over(c.peak_bytes, c.points)),
    )
    rows = []
    for family in dict.fromkeys(cell.family for cell in cells):
        row = [family]
        for method in _methods(cells):
            own = [
                c
                for c in cells
                if (c.method, c.family) == (method, family) and c.refusal is None
            ]
            figures = []
            for _, figure in kinds:
                values = [v for cell in own if (v := figure(cell)) is not None]
                figures.append(f"{median(values):.3g}" if values else "-")
            row.append(" / ".join(figures))
        rows.append(row)
    note = " / ".join(name for name, _ in kinds)
    return f"{note}; medians over the scenes of a class.\n\n" + table(
        ["class", *_methods(cells)], rows
    )


def chosen_without(found: LeaveOneOut) -> str:
    """What each sample got from the settings that were best on the others."""
    grid = "; ".join(
        f"`{name}` {', '.join(_value(v) for v in values)}"
        for name, values in found.grid.items()
    )
    rows = [
        [
            fold.sample,
            ", ".join(f"{k} {_value(v)}" for k, v in fold.settings.items()) or "the default",
            percent(fold.default),
            percent(fold.total),
        ]
        for fold in found.folds
    ]
    default, left_out = mean(f.default for f in found.folds), mean(f.total for f in found.folds)
    few = (
        ""
        if found.most_changed is None
        else f" with at most {found.most_changed} value changed"
    )
    rows.append(["mean", "", percent(default), percent(left_out)])
    return (
        f"Total error. All {found.settings} settings of this grid{few}, declared beforehand (the default is in its "
        f"middle): {grid}. For each sample the setting with the least mean error on the others was taken, and scored "
        f"on it: {percent(left_out)} against {percent(default)} with the default, {100 * (left_out - default):+.2f} "
        "points. "
        f"The best of the grid on all samples, chosen with hindsight: {percent(found.best)}.\n\n"
        + table(["sample", "what was best on the others", "default", "left out"], rows)
    )


def _value(value: float | tuple[float, ...]) -> str:
    """A number, or two limits."""
    return " to ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"


def _over(part: float | None, whole: float | None) -> float | None:
    return part / whole if part is not None and whole else None


def _refusals(cells: Sequence[Cell]) -> str:
    """The reasons, with the scenes where they were given."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        if cell.refusal is not None:
            reasons.setdefault((cell.method, cell.refusal), []).append(cell.scene)
    return (
        "\n".join(
            f"- `{method}` on {', '.join(scenes)}: {text}"
            for (method, text), scenes in reasons.items()
        )
        + "\n"
    )


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _published() -> str:
    """Figures of others, as printed."""
    samples = list(PER_SAMPLE[0].samples)
    per_sample = [
        [
            entry.name,
            *(" / ".join(_number(v) for v in entry.samples[s]) for s in samples),
            _number(mean(total for _, _, total in entry.samples.values())),
        ]
        for entry in PER_SAMPLE
    ]
    means = [
        [
            m.name,
            m.data,
            _number(m.type_1),
            _number(m.type_2),
            _number(m.total),
            _number(m.kappa, 1),
            m.source,
        ]
        for m in MEANS
    ]
    rmses = [
        [
            r.name,
            r.data,
            _number(r.residential, 3),
            _number(r.mountain, 3),
            _number(r.both, 3),
            r.source,
        ]
        for r in RMSES
    ]
    return "\n".join(
        (
            "None of these was measured by this script: they are printed in the papers, on their authors' data, and "
            "often tuned for each sample, or were measured earlier where it says so.\n",
            "Type I / type II / total of the ISPRS samples that are open here, and the mean total:\n",
            table(["published", *samples, "mean"], per_sample),
            "Sources: "
            + "; ".join(dict.fromkeys(f"{entry.name}: {entry.source}" for entry in PER_SAMPLE))
            + ".\n",
            "Means:\n",
            table(
                ["published", "data", "type I", "type II", "total", "kappa", "source"], means
            ),
            "RMSE of DTMs, m:\n",
            table(["published", "data", "residential", "mountain", "all", "source"], rmses),
        )
    )
