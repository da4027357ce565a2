"""The comparison of three papers with `classic`, repeated on simulated scenes like theirs, as Markdown.

``python tests/benchmarks/papers.py [OUT.md] [--only ridge2016|dong2018|dong2017|starts]``

Each paper's method and `classic`, both with the paper's own parameters and with our defaults,
beside the published figures. Scenes are those of the simulator's catalogue, or their sites with
other seeds and another sensor. ``starts`` has each method on all matched scenes, semi-real and
simulated, from the lowest points as in its paper and from robust cells.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd import classify
from ptd.frame import Scale, Window
from ptd.methods import make_params
from ptd.methods.dong2017.histograms import gli_bins
from ptd.methods.dong2017.method import Dong2017
from ptd.passes import Points
from tests.benchmarks.measuring import GROUND, dtm_rmse_m
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import (
    SIMULATED,
    Cloud,
    semi_real_scenes,
    simulated,
    simulated_scenes,
)
from tests.benchmarks.scorecard_text import table
from tiler.apps.evaluate import IGNORED, evaluate_labels

LOW_NOISE = 7

VERTICES = {"label_pass": "no", "rounds": "0"}
CLASSIC_003 = {
    "iteration_angle": "6",
    "edge_length_reduce": "0",
    "edge_length_stop": "1",
    **VERTICES,
}
LOWEST = {"robust_cells": "no"}
"""The papers' start, from the lowest point of each cell."""
RIDGE_003 = {
    "iteration_angle": "6",
    "edge_length_reduce": "0",
    "label_floor": "0",
    "rounds": "60",
    **LOWEST,
}
PAPER_000 = {"max_building_size": "30", "iteration_angle": "6"}
CLASSIC_000 = {**PAPER_000, "edge_length_reduce": "0", "thin_cell": "0", **VERTICES}
DONG18_000 = {**PAPER_000, "density_k": "10", **LOWEST}
"""The papers' parameters, by the name of ``--set``; what is not here is our default because it is theirs too.

`classic` as the papers have it ends when no point passes, and only its vertices are ground.
"""


def found_ground(
    cloud: Cloud, method: str, texts: dict[str, str], sigma: float | None = None
) -> Any:
    """The result of a method with parameters as ``--set`` has them."""
    return classify(
        cloud.xyz,
        method,
        make_params(method, texts),
        rgb=cloud.rgb,
        returns=cloud.returns,
        sigma=sigma,
    )


def errors(cloud: Cloud, labels: np.ndarray, judged: np.ndarray | None = None) -> str:
    """Type I / II / total in percent, of the points that are judged."""
    which = np.ones(len(labels), bool) if judged is None else judged
    ground = np.where(labels[which] == GROUND, GROUND, 1).astype(np.uint8)
    found = evaluate_labels(ground, cloud.classification[which], IGNORED)
    return " / ".join(f"{100 * found[key]:.2f}" for key in ("type_1", "type_2", "total"))


def mountain_by_matching(seed: int) -> Cloud:
    """The site of `als_mountain` as image matching at 6 points/m2 with 0.15 m of noise, like the data of 003."""
    from tiler.simulate.catalogue import SCENES
    from tiler.simulate.points import survey

    sensor: dict[str, Any] = {"density": 6.0, "sigma_m": 0.15}
    spec = replace(SCENES["als_mountain"], kind="dim", seed=seed, sensor=sensor)
    site = spec.make_site()
    points = survey(site, spec.make_sensor())
    return Cloud(
        points.xyz,
        points.label,
        points.rgb,
        None,
        truth=site.terrain.height_at,
        side_m=spec.side_m,
    )


def ridge2016() -> str:
    """RMSE of the DTM on mountains beside a settlement."""
    clouds = {name: simulated(name) for name in ("als_mountain", "als_mountain_dense")}
    clouds |= {f"matched {seed}": mountain_by_matching(seed) for seed in (133, 134)}
    runs = [
        ("`classic`, paper's parameters", "classic", CLASSIC_003, (1.286, 1.309)),
        ("`ridge2016`, paper's parameters", "ridge2016", RIDGE_003, (0.963, 1.007)),
        ("`classic`, default", "classic", {}, ()),
        ("`ridge2016`, default, lowest points", "ridge2016", LOWEST, ()),
        ("`ridge2016`, default", "ridge2016", {}, ()),
        ("`auto`", "auto", {}, ()),
    ]
    rows = []
    for title, method, texts, printed in runs:
        labels = [
            found_ground(cloud, method, texts).classification for cloud in clouds.values()
        ]
        found = [
            dtm_rmse_m(c, own == GROUND) for c, own in zip(clouds.values(), labels, strict=True)
        ]
        theirs = " / ".join(f"{v:.3f}" for v in printed) or "-"
        rows.append([title, *(f"{v:.2f}" for v in found), theirs])
    note = "RMSE of the DTM at 1 m against the true terrain, m; the paper's figures are of its two data sets.\n\n"
    return "### `ridge2016`\n\n" + note + table(["", *clouds, "paper"], rows)


def dong2018() -> str:
    """Errors on matched clouds of 40 points/m2 with 0.066 m of noise, and thresholds by scale."""
    names = ("dim_area_city", "dim_area_suburb")
    clouds = {name: simulated(name) for name in names}
    for name in names:
        kept = clouds[name].classification != LOW_NOISE
        clouds[f"{name}, no blunders"] = only(clouds[name], kept)
    classics, theirs = (
        "11.09 / 9.73 / 10.74; 12.52 / 6.2 / 9.94",
        "5.52 / 11.62 / 7.43; 3.03 / 7.3 / 5.08",
    )
    runs: list[tuple[str, str, dict[str, str], float | None, str]] = [
        ("`classic`, paper's parameters", "classic", CLASSIC_000, None, classics),
        ("`dong2018`, paper's parameters", "dong2018", DONG18_000, 0.066, theirs),
        ("`classic`, default", "classic", {}, None, "-"),
        ("`dong2018`, default, lowest points", "dong2018", LOWEST, None, "-"),
        ("`dong2018`, lowest points, sigma 0.066", "dong2018", LOWEST, 0.066, "-"),
        ("`dong2018`, default", "dong2018", {}, None, "-"),
        ("`auto`", "auto", {}, None, "-"),
    ]
    rows, scales = [], []
    for title, method, texts, sigma, printed in runs:
        row = [title]
        for name, cloud in clouds.items():
            result = found_ground(cloud, method, texts, sigma)
            row.append(errors(cloud, result.classification))
            if "scales" in result.decisions["statistics"] and name in names:
                steps = result.decisions["statistics"]["scales"]
                step = "{scale_m:g} m: {distance_m:.3f} m, {angle_deg:.1f}°"
                by_scale = [step.format(**found) for found in steps]
                scales.append([f"{name}, {title}", "; ".join(by_scale)])
        rows.append([*row, printed])
    note = "Type I / II / total, %; the paper's areas 11 and 32, whose seeds were picked by hand.\n\n"
    head = ["", *clouds, "paper, areas 11; 32"]
    thresholds = "\nThresholds by scale (the paper's figure 12: the distance shrinks, the angle grows):\n\n"
    return (
        "### `dong2018`\n\n"
        + note
        + table(head, rows)
        + thresholds
        + table(["scene", "thresholds"], scales)
    )


def dong2017() -> str:
    """Errors on coloured cities with facades, vegetation taken out before, as the paper does."""
    from scipy.spatial import Delaunay

    runs: list[tuple[str, str, dict[str, str]]] = [
        ("`dong2017`, on points", "dong2017", LOWEST),
        ("`dong2017`, default", "dong2017", {}),
        ("`classic`, papers' parameters", "classic", CLASSIC_000),
        ("`classic`, default", "classic", {}),
        ("`auto`", "auto", {}),
    ]
    rows = []
    for name in ("dim_city", "dim_area_city", "dim_area_suburb"):
        cloud = simulated(name)
        own = found_ground(cloud, "dong2017", {})
        statistics = own.decisions["statistics"]
        grey = gli_bins(np.ascontiguousarray(cloud.rgb.T)) < statistics["green_from"]  # type: ignore[union-attr]
        hull = Delaunay(cloud.xyz[seeds_of(cloud), :2])
        between = grey & (hull.find_simplex(cloud.xyz[:, :2]) >= 0)
        for title, method, texts in runs:
            labels = found_ground(cloud, method, texts).classification
            rows.append(
                [
                    f"{name}, {title}",
                    errors(cloud, labels, between),
                    errors(cloud, labels, grey),
                ]
            )
    rows.append(["paper", "0.00 / 2.39 / 1.53", "-"])
    note = (
        "Type I / II / total, %, without what is vegetation by its colour. *Between facades*: within the hull of the "
        "seeds, as the paper's own test area.\n\n"
    )
    return "### `dong2017`\n\n" + note + table(["", "between facades", "everywhere"], rows)


def seeds_of(cloud: Cloud) -> np.ndarray:
    """Which points are seeds of `dong2017`: its first two passes; bool [n]."""
    counts = np.rint((cloud.xyz - cloud.xyz.min(axis=0)) * 1000).astype(np.int32).T
    assert cloud.rgb is not None
    points = Points(np.ascontiguousarray(counts), rgb=np.ascontiguousarray(cloud.rgb.T))
    window, scale = Window.everything(), Scale()
    state: dict[str, Any] = {"run": {"rgb": True, "sigma_m": None}}
    first, second = Dong2017(robust_cells=False).passes[:2]
    state = first.reduce([first.fit(points, window, window, scale, state).partial()], state)
    labels, _ = second.fit(points, window, window, scale, state).label(points)
    found: np.ndarray = labels == GROUND
    return found


def only(cloud: Cloud, which: np.ndarray) -> Cloud:
    """Some points of a cloud."""
    rgb = None if cloud.rgb is None else cloud.rgb[which]
    returns = None if cloud.returns is None else cloud.returns[which]
    return replace(
        cloud,
        xyz=cloud.xyz[which],
        classification=cloud.classification[which],
        rgb=rgb,
        returns=returns,
    )


STARTS: dict[str, dict[str, dict[str, str]]] = {
    name: {"lowest points": LOWEST, "robust cells": {}}
    for name in ("chen2023", "ridge2016", "dong2018", "dong2017")
}
"""Methods that take robust cells for the lowest points of matched clouds, and the parameters
that say so."""


def starts() -> str:
    """Errors and RMSE of the DTM on all matched scenes, from the lowest points and from robust cells."""
    scenes = [
        *semi_real_scenes(DATA),
        *(scene for scene in simulated_scenes() if scene.group == SIMULATED["dim"]),
    ]
    columns = {(m, start): texts for m, by in STARTS.items() for start, texts in by.items()}
    rows = []
    for scene in scenes:
        cloud = scene.load()
        rows.append(
            [scene.name, *(_figures(cloud, m, texts) for (m, _), texts in columns.items())]
        )
    note = "Type I / II / total, %, and RMSE of the DTM at 1 m, m; our parameters but for the start.\n\n"
    return (
        "### Two starts\n\n"
        + note
        + table(["", *(f"`{m}`, {start}" for m, start in columns)], rows)
    )


def _figures(cloud: Cloud, method: str, texts: dict[str, str]) -> str:
    """Errors and RMSE, or that the method refuses."""
    try:
        ground = found_ground(cloud, method, texts).classification == GROUND
    except ValueError:  # the cloud, or a column that it lacks
        return "refused"
    rmse_m = dtm_rmse_m(cloud, ground)
    found = evaluate_labels(
        np.where(ground, GROUND, 1).astype(np.uint8), cloud.classification, IGNORED
    )
    shares = " / ".join(f"{100 * found[key]:.1f}" for key in ("type_1", "type_2", "total"))
    return shares if rmse_m is None else f"{shares}, {rmse_m:.2f}"


PAPERS: dict[str, Callable[[], str]] = {
    make.__name__: make for make in (ridge2016, dong2018, dong2017, starts)
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(
        description="Repeat three papers' comparisons with classic."
    )
    parser.add_argument(
        "out", type=Path, nargs="?", help="Markdown file; without: standard output"
    )
    parser.add_argument("--only", choices=list(PAPERS), help="one paper")
    given = parser.parse_args(arguments)
    text = "\n".join(PAPERS[name]() for name in ([given.only] if given.only else PAPERS))
    if given.out is None:
        print(text)
    else:
        given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
