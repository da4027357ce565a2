"""Fits the constants of `tiler.grid.sigma` to scenes whose terrain is known, and scores each scene left out.

``python -m tests.benchmarks.sigma_constants FOLDER [--scenes als_city,bluff] [--kinds als,dim]``

The scenes are those of the simulator, the semi-real matched clouds, and the labelled laser
scans of ``../shared/data`` (`tests.benchmarks.sigma_scenes`). Each is filtered and gridded with
the default settings; runs and what they found stay in FOLDER. The weights are not negative and
make the squared errors most likely if these are normally distributed about the predicted
variance; a scene weighs as much as any other. Markdown goes to the standard output.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_text import table
from tests.benchmarks.sigma_scenes import Known, Pixels, known_scenes, pixels_of, ran
from tiler.grid.sigma import FLOOR_M2, LINEAR, Measures, Weights, terms

POINTS = 1500
"""Pixels of a scene that are fitted to."""
SCORED = 40_000
"""Pixels of a scene that are scored."""
STEPS = 25
RIDGE = 1e-9
WRONG_M, LOOKED_AT = 0.5, 0.1
"""Pixels are wrong beyond this; a person looks at this share of the area."""
MIN_WRONG = 20
"""Wrong pixels of a scene from which on it counts how many of them are found."""
GIVEN = {
    "als": {"always": FLOOR_M2, "roughness": LINEAR},
    "dim": {"always": FLOOR_M2, "water": 0.0466},
}
"""Weights that are not fitted: the least error; what theory says of laser scans; of matched
clouds hardly any water."""
NAMES = tuple(field.name for field in fields(Weights))


class Sample:
    """Pixels of a scene: terms [n, names] and squared errors [n]; the first `POINTS` are fitted to."""

    def __init__(self, known: Known, pixels: Pixels) -> None:
        chosen = np.random.default_rng(1).permutation(pixels.error.size)[:SCORED]
        self.name, self.kind, self.group = known.name, known.kind, known.group
        self.error = pixels.error[chosen]
        found = terms(Measures(*pixels.measures[:, chosen]), pixels.mask[chosen])
        self.terms = np.stack([found[name] for name in NAMES], axis=1)


def fitted(samples: Sequence[Sample], given: Mapping[str, float]) -> np.ndarray:
    """Weights in the order of `NAMES`."""
    X = np.concatenate([sample.terms[:POINTS] for sample in samples])
    squared = np.concatenate([sample.error[:POINTS] ** 2 for sample in samples])
    weights = np.array([given.get(name, 0.0) for name in NAMES])
    free = np.array([name not in given for name in NAMES]) & (X != 0).any(axis=0)
    base, Y = X @ weights, X[:, free]
    variance = np.full(squared.size, squared.mean())
    for _ in range(STEPS):
        weighed = Y / variance[:, np.newaxis] ** 2
        normal, right = weighed.T @ Y, weighed.T @ (squared - base)
        scale = np.sqrt(np.diag(normal))
        root = np.linalg.cholesky(normal / np.outer(scale, scale) + RIDGE * np.eye(scale.size))
        found, _ = nnls(root.T, np.linalg.solve(root, right / scale))
        weights[free] = found / scale
        variance = (variance + np.maximum(X @ weights, FLOOR_M2)) / 2
    return weights


def scored(sample: Sample, weights: np.ndarray) -> dict[str, float]:
    """True and predicted RMSE, shares within 1, 2 and 3 sigma, and the attainable share that is found."""
    sigma, off = np.sqrt(sample.terms @ weights), np.abs(sample.error)
    wrong = off > WRONG_M
    looked = np.argsort(-sigma, kind="stable")[: max(int(LOOKED_AT * sigma.size), 1)]
    found = float("nan")
    if wrong.sum() >= MIN_WRONG:
        found = wrong[looked].sum() / min(wrong.sum(), looked.size)
    within = {f"within_{k}": float(np.mean(off <= k * sigma)) for k in (1, 2, 3)}
    true, predicted = (float(np.sqrt(np.mean(v**2))) for v in (off, sigma))
    return {
        "true": true,
        "predicted": predicted,
        **within,
        "wrong": float(wrong.mean()),
        "found": float(found),
    }


def report(samples: Sequence[Sample], kind: str) -> str:
    """Each scene with the weights of the others, their summary, and the weights of all, as Markdown."""
    mine = [sample for sample in samples if sample.kind == kind]
    results = {
        sample.name: scored(
            sample, fitted([other for other in mine if other is not sample], GIVEN[kind])
        )
        for sample in mine
    }
    rows = [
        [
            name, f"{r['true']:.3f}", f"{r['predicted']:.3f}", f"{r['predicted'] / r['true']:.2f}",
            *(f"{100 * r[f'within_{k}']:.0f}" for k in (1, 2, 3)), f"{100 * r['wrong']:.1f}",
            "" if np.isnan(r["found"]) else f"{100 * r['found']:.0f}",
        ]
        for name, r in results.items()
    ]  # fmt: skip
    names = [
        "scene",
        "true RMSE m",
        "predicted m",
        "ratio",
        "within 1 sigma %",
        "2",
        "3",
        "wrong %",
        "found %",
    ]
    ratios = np.abs([np.log(r["predicted"] / r["true"]) for r in results.values()])
    close, wide = (int((ratios < np.log(factor)).sum()) for factor in (1.5, 2.0))
    shares = [np.mean([r[f"within_{k}"] for r in results.values()]) for k in (1, 2, 3)]
    found = np.nanmean([r["found"] for r in results.values()])
    summary = (
        f"{kind}: RMSE within a factor of 1.5 in {close}, of 2 in {wide} of {len(mine)} scenes; errors within 1, 2, 3 "
        f"sigma: {', '.join(f'{100 * share:.0f}' for share in shares)} %; attainable share of wrong pixels found: "
        f"{100 * found:.0f} %"
    )
    weights = ", ".join(
        f"{name}={value:.3g}"
        for name, value in zip(NAMES, fitted(mine, GIVEN[kind]), strict=True)
    )
    return f"{table(names, rows)}\n\n{summary}\n\nWeights({weights})\n"


def sampled(known: Known, folder: Path) -> Sample:
    """The pixels of a scene, which are kept in the folder."""
    kept = folder / "pixels" / f"{known.name}.npz"
    if not kept.exists():
        pixels = pixels_of(known, ran(known, folder))
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(kept, measures=pixels.measures, mask=pixels.mask, error=pixels.error)
    with np.load(kept) as found:
        return Sample(known, Pixels(found["measures"], found["mask"], found["error"]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, fit, print."""
    parser = argparse.ArgumentParser(description="Fit the constants of the standard error.")
    parser.add_argument("folder", type=Path, help="folder for the runs")
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--kinds", default="als,dim", help="only these, with commas")
    given = parser.parse_args(arguments)
    only = given.scenes.split(",") if given.scenes else None
    kinds = given.kinds.split(",")
    known = [
        k for k in known_scenes(DATA) if k.kind in kinds and (only is None or k.name in only)
    ]
    samples = [sampled(k, given.folder) for k in known]
    for kind in kinds:
        print(report(samples, kind))


if __name__ == "__main__":
    main()
