"""How many places of review.gpkg are wrong on scenes whose terrain is known, and how well the chances fit.

``python -m tests.benchmarks.places [--seeds 2] [--scenes als_city,bluff] [--keep FOLDER]``

The scenes are those of the simulator, with other seeds too, those of the sigma benchmark that are not simulated, and
the matched clouds made of laser scans (`tests.benchmarks.scan_scenes`). Every second seed has gaps, as of missing
strips and clouds. Each is run with the default settings at pixels of 1 m, of 0.5 m for matched clouds, and `judged`
says which places are wrong. ``--keep`` keeps what was judged in a folder, for a version of tiler. Markdown goes to the
standard output.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rasterio
import shapely
from pyogrio import raw

from tests.benchmarks.kept import Kept, digest
from tests.benchmarks.scan_scenes import scan_scenes
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import Cloud
from tests.benchmarks.scorecard_text import table
from tests.benchmarks.sigma_scenes import CORNER, known_scenes, placed, written
from tiler.config import RunConfig
from tiler.core.chances import (
    LEAST_PLACES,
    LIDAR,
    PHOTOGRAMMETRIC,
    REASONS,
    Counts,
    Reason,
    chance_from,
)
from tiler.pipeline import run
from tiler.simulate import SCENES
from tiler.simulate.catalogue import SceneSpec
from tiler.simulate.points import survey

WRONG_M = 0.5
"""Heights are off beyond this, more than any true height of the pixel and its eight neighbours."""
WRONG_M2, WRONG_SHARE, WRONG_SHARE_OF_SMALL = 4.0, 0.1, 0.5
"""Area and share of a place that have to be off; of a small place, half of it suffices."""
KNOWN_SHARE = 0.5
"""Least share of a place in which the true terrain is known."""
PIXELS_M = {"als": "1", "dim": "0.5"}
SEED_STEP = 1000
GAP_M2 = 3000.0
"""A scene with gaps has one per such an area."""
GAP_SIDES_M = (6.0, 40.0)
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)

Array = np.ndarray
Truth = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class TrueScene:
    """Scene whose terrain is known.

    Scenes of a family differ by seeds and gaps; they are left out together.
    """

    name: str
    family: str
    kind: str
    load: Callable[[], Cloud]


@dataclass(frozen=True)
class Judged:
    """Place of a run: its scene, what the file says of it, and what the truth says.

    ``share`` is the share of its area that is off, ``error_m`` the RMS of what is off in metres (None where there is no
    height), and ``known`` says whether the truth is known in enough of it.
    """

    scene: str
    family: str
    kind: str
    reason: str
    area_m2: float
    stake_m: float | None
    known: bool
    wrong: bool
    share: float
    error_m: float | None


def true_scenes(data: Path, seeds: int) -> Iterator[TrueScene]:
    """All scenes, as far as their files are there."""
    for known in known_scenes(data):
        if known.group == "real":
            load = partial(placed, known.scene)
            yield TrueScene(known.name, known.name, known.kind, load)
    for scene in scan_scenes(data):
        yield TrueScene(f"scan {scene.name}", scene.name, "dim", scene.load)
    for name, spec in SCENES.items():
        for number in range(seeds):
            seeded = replace(spec, seed=spec.seed + SEED_STEP * number)
            load = partial(simulated, seeded, number % 2 == 1)
            yield TrueScene(f"{name}-{number}", name, spec.kind, load)


def simulated(spec: SceneSpec, has_gaps: bool) -> Cloud:
    """The cloud of a scene of the simulator, perhaps with gaps."""
    site = spec.make_site()
    points = survey(site, spec.make_sensor())
    if has_gaps:
        points = points.take(~in_gaps(points.xyz, np.random.default_rng(spec.seed)))
    returns = np.column_stack((points.number, points.count))
    truth = site.terrain.height_at
    return Cloud(points.xyz, points.label, points.rgb, returns, truth, spec.side_m)


def in_gaps(xyz: Array, rng: np.random.Generator) -> Array:
    """Whether points lie in one of some rectangles of any direction."""
    east, north = xyz[:, :2].max(axis=0)
    inside = np.zeros(len(xyz), bool)
    for _ in range(max(round(east * north / GAP_M2), 2)):
        x, y = xyz[:, 0] - rng.uniform(0, east), xyz[:, 1] - rng.uniform(0, north)
        turn, (long, wide) = rng.uniform(0, np.pi), np.exp(rng.uniform(*np.log(GAP_SIDES_M), 2))
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        inside |= (abs(along) < long / 2) & (abs(across) < wide / 2)
    return inside


def places_of(scene: TrueScene) -> list[Judged]:
    """The judged places of a run of a scene with the default settings."""
    cloud = scene.load()
    with TemporaryDirectory() as folder:
        path, out = Path(folder, "cloud.laz"), Path(folder, "out")
        written(cloud, path)
        settings = {
            "products": "dtm", "kind": scene.kind, "keep_classes": "none", "workers": 1, "in_process": True,
            "crs": "EPSG:25832", "memory": "3GiB", "resolution": PIXELS_M[scene.kind], "classified": "las",
        }  # fmt: skip
        run([str(path)], out, RunConfig.from_mapping(settings))
        assert cloud.truth is not None
        return list(judged(scene, out, cloud.truth))


def judged(scene: TrueScene, out: Path, truth: Truth) -> Iterator[Judged]:
    """Say of each place of a run whether it is wrong: whether an operator would change the terrain in it.

    A pixel is off if it has no height where there is land or water, or if its height is more than `WRONG_M` above or
    below all true heights of the pixel and its eight neighbours, so that an edge that is moved by a pixel is right. A
    place is wrong if the pixels that are off have at least `WRONG_M2` and `WRONG_SHARE` of its area, or
    `WRONG_SHARE_OF_SMALL` of it. A place that is narrower than a pixel is judged by the pixel of its middle.
    Pixels whose true height is not known do not count.
    """
    with rasterio.open(out / "dtm.tif") as raster:
        heights = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
        size, corner = raster.res[0], raster.bounds
    rows, columns = np.indices(heights.shape)
    x, y = corner.left + (columns + 0.5) * size, corner.top - (rows + 0.5) * size
    low, high = ranges(np.asarray(truth(x - CORNER[0], y - CORNER[1])))
    beyond = np.maximum(np.maximum(heights - high, low - heights), 0.0)
    meta, _, shapes, values = raw.read(out / "review.gpkg", layer="review")
    named = dict(zip(meta["fields"], values, strict=True))
    for i, wkb in enumerate(shapes):
        shape = shapely.from_wkb(wkb)
        inside = shapely.contains_xy(shape, x, y)
        if not inside.any():
            middle = shape.representative_point()
            inside = np.hypot(x - middle.x, y - middle.y) <= size / 2**0.5
        known = inside & ~np.isnan(low)
        off = known & ~(beyond <= WRONG_M)
        error = beyond[off & ~np.isnan(beyond)]
        area_m2, off_m2 = (float(pixels.sum()) * size**2 for pixels in (known, off))
        least = min(max(WRONG_M2, WRONG_SHARE * area_m2), WRONG_SHARE_OF_SMALL * area_m2)
        stake = float(named["stake_m"][i])
        yield Judged(
            scene=scene.name,
            family=scene.family,
            kind=LIDAR if scene.kind == "als" else PHOTOGRAMMETRIC,
            reason=str(named["reason"][i]),
            area_m2=float(shape.area),
            stake_m=None if np.isnan(stake) else stake,
            known=bool(inside.any() and known.sum() >= KNOWN_SHARE * inside.sum()),
            wrong=bool(off_m2 > 0 and off_m2 >= least),
            share=off_m2 / area_m2 if area_m2 else 0.0,
            error_m=float(np.sqrt(np.mean(error**2))) if error.size else None,
        )


def ranges(heights: Array) -> tuple[Array, Array]:
    """Lowest and highest height of each pixel and its neighbours, NaN where the pixel has none."""
    wide = np.pad(heights, 1, constant_values=np.nan)
    rows, columns = heights.shape
    around = [wide[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    missing = np.isnan(heights)
    low, high = np.fmin.reduce(around), np.fmax.reduce(around)
    return np.where(missing, np.nan, low), np.where(missing, np.nan, high)


def by_reason(places: Iterable[Judged]) -> dict[tuple[str, str], list[Judged]]:
    """The places whose truth is known, by reason and kind of cloud."""
    groups: dict[tuple[str, str], list[Judged]] = {}
    for place in places:
        if place.known:
            groups.setdefault((place.reason, place.kind), []).append(place)
    return dict(sorted(groups.items()))


def left_out(places: Sequence[Judged]) -> list[tuple[float, bool]]:
    """The chance of each place by the scenes of the other families, and whether it is wrong.

    Places that are wrong by definition have no chance.
    """
    found = []
    for (name, _), group in by_reason(places).items():
        reason = REASONS.get(name, Reason())
        for place in () if reason.is_certain else group:
            others = [other for other in group if other.family != place.family]
            chance = chance_from(counts_of(reason, others), reason.size(place.area_m2))
            if chance is not None:
                found.append((chance, place.wrong))
    return found


def counts_of(reason: Reason, places: Iterable[Judged]) -> list[Counts]:
    """Numbers of places and of wrong ones, by size if the reason has sizes."""
    sizes: list[list[bool]] = [[] for _ in range(1 if reason.large_m2 is None else 2)]
    for place in places:
        sizes[reason.size(place.area_m2)].append(place.wrong)
    return [Counts(len(wrong), sum(wrong)) for wrong in sizes]


def text_of(places: Sequence[Judged]) -> str:
    """Tables of the places by reason, and of the chances of scenes left out, as Markdown."""
    rows = []
    for (name, kind), group in by_reason(places).items():
        errors = [place.error_m for place in group if place.wrong and place.error_m is not None]
        error = f"{np.median(errors):.2f}" if errors else "-"
        families = str(len({place.family for place in group}))
        reason = REASONS.get(name, Reason())
        for size, counts in enumerate(counts_of(reason, group)):
            limit = "" if reason.large_m2 is None else f"{'<>'[size]} {reason.large_m2:g}"
            numbers = (str(n) for n in counts)
            rows.append([name, kind, limit, families, *numbers, error])
    head = ["reason", "kind", "area, m2", "scenes", "places", "wrong", "median error, m"]
    chances = left_out(places)
    bins = []
    for first, last in itertools.pairwise(BINS):
        inside = [
            is_wrong
            for chance, is_wrong in chances
            if first <= chance < last or chance == last == 1.0
        ]
        share = f"{100 * np.mean(inside):.0f}" if inside else "-"
        bins.append([f"{100 * first:.0f} to {100 * last:.0f} %", str(len(inside)), share])
    return (
        f"{table(head, rows)}\n\nChances by the other scenes, of reasons with at least {LEAST_PLACES} places there:\n\n"
        f"{table(['chance', 'places', 'wrong, %'], bins)}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, judge, print."""
    parser = argparse.ArgumentParser(description="Judge places to review by the true terrain.")
    parser.add_argument("--seeds", type=int, default=2, help="seeds of each simulated scene")
    parser.add_argument("--scenes", help="only those of these families, with commas")
    parser.add_argument("--keep", type=Path, help="folder for what was judged")
    given = parser.parse_args(arguments)
    only = given.scenes.split(",") if given.scenes else None
    kept, places = Kept(given.keep), []
    for scene in true_scenes(DATA, given.seeds):
        if only is None or scene.family in only:

            def make(scene: TrueScene = scene) -> list[dict[str, object]]:
                return [asdict(place) for place in places_of(scene)]

            places += [Judged(**entry) for entry in kept(digest(scene.name), make)]
    print(text_of(places))


if __name__ == "__main__":
    main()
