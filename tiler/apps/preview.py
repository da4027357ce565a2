"""Preview of a run in seconds: a few windows at full density, filtered, gridded and drawn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ptd.arrays import UInt8
from ptd.gridding.shape import gradients, multidirectional_hillshade
from tiler.config import RunConfig
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.errors import InputError
from tiler.inputs import SourceInfo, read_in_child
from tiler.io.las.extract import cut_windows, sample_places
from tiler.io.las.octree import Box
from tiler.io.overwrite_check import Target, check_targets
from tiler.io.raster_files import write_png
from tiler.io.result_folder import STORE
from tiler.observe.events import Event, Listener, Note, Warned, ignore_events
from tiler.pipeline import run
from tiler.plan import Plan, make_plan
from tiler.schedule import ChildProcess
from tiler.store import TileStore, open_store

MAX_WIDTH_M = 200.0
"""Maximum default side of a window in metres, which shows a few blocks of a town."""
MIN_WIDTH_M = 20.0
"""Minimum default side of a window in metres, below which a building would fill it."""
MAX_POINTS = 700_000
"""Number of points that limits the default side of a window.

One core processes this number in a few seconds.
"""
FILES = 6
"""Maximum number of files that are sampled for positions of windows."""
PLACES = 24
"""Number of positions that are sampled in all files together, at least one in each file."""
GAP = 6
"""Number of pixels between pictures."""
WIDE_PIXELS = 320
"""Minimum side of the largest window's picture in pixels. Smaller pictures are enlarged."""
EMPTY_GREY = 236
"""Grey of pixels without a height, which is lighter than shaded ground."""
PAPER = 255
"""Grey of the background."""

Shade = UInt8


@dataclass(frozen=True)
class PreviewWindow:
    """Window of the preview.

    Attributes
    ----------
    bounds : tuple of 4 float
        Lowest x, y, highest x, y in units of the CRS.
    points, ground : int
        Number of points in the window, and of points labelled ground.
    failed : int
        Number of failed tasks, which cause holes in the picture.
    """

    bounds: Box
    points: int
    ground: int
    failed: int = 0


def make_preview(
    inputs: Sequence[str],
    target: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
    *,
    number: int = 3,
    side_m: float | None = None,
) -> list[PreviewWindow]:
    """Draw hillshades of surface and terrain in a few windows of the clouds, for the settings of a run.

    Each window is processed separately. A run may differ at the borders of the windows, and
    because of its run-wide statistics. After sampling, only files that windows intersect are
    decoded.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs.
    target : path
        PNG with a column for each window, in which the surface (highest returns) is above the terrain.
    config : RunConfig
    listener : callable
        Function that receives the notes of the plan, a note per window, and each warning once.
    number : int
        Maximum number of windows, which do not overlap.
    side_m : float, optional
        Side of a window, metres. The default is up to 200, and less in dense clouds.

    Raises
    ------
    TilerError
        `tiler.pipeline.run` raises it, or no window contains points.
    """
    config = config or RunConfig()
    picture = Target("-o", target, (".png",))
    check_targets([picture], [])
    plan = make_plan(inputs, config)
    reads: list[str | Path] = [source.path for source in plan.inputs.sources]
    check_targets([picture], [*reads, *(path for path, _ in plan.inputs.left_out)])
    tell = _once(listener)
    for text in plan.notes:
        listener(Note(text))
    for text in plan.warnings:
        tell(Warned(text))
    sources = plan.inputs.filled
    side = _side(plan, side_m)
    with TemporaryDirectory(prefix=".tiler-preview-") as scratch, ChildProcess() as guard:
        positions = _places(guard, sources, config.salvage)
        windows = spread(positions, number, side, _hull(sources))
        files = _cut(guard, sources, windows, Path(scratch), config.salvage)
        settings = _settings(plan)
        made: list[tuple[tuple[Shade, Shade], PreviewWindow]] = []
        filled = [(b, paths) for b, paths in zip(windows, files, strict=True) if paths]
        for number_drawn, (bounds, paths) in enumerate(filled, start=1):
            listener(Note(f"draw window {number_drawn} of {len(filled)}"))
            made.append(_window(bounds, paths, settings, tell))
    write_png(Path(target), _montage([column for column, _ in made]))
    return [window for _, window in made]


def _once(listener: Listener) -> Listener:
    """Return a listener that forwards each warning once, and does not forward other events."""
    seen: set[str] = set()

    def tell(event: Event) -> None:
        if isinstance(event, Warned) and event.text not in seen:
            seen.add(event.text)
            listener(event)

    return tell


def _side(plan: Plan, side_m: float | None) -> float:
    if side_m is None:
        side_m = min(MAX_WIDTH_M, math.sqrt(MAX_POINTS / plan.inputs.density))
        side_m = max(side_m // 10 * 10, MIN_WIDTH_M)
    return side_m / float(plan.frame.units.horizontal)


def _places(
    guard: ChildProcess, sources: Sequence[SourceInfo], salvage: bool
) -> list[tuple[float, float]]:
    chosen = sorted({len(sources) * i // FILES for i in range(FILES)})
    each = max(PLACES // len(chosen), 1)
    return [
        place
        for source in (sources[i] for i in chosen)
        for place in read_in_child(
            guard, sample_places, source.path, each, salvage, source.octree
        )
    ]


def _hull(sources: Sequence[SourceInfo]) -> Box:
    bounds = np.array([s.bounds for s in sources])
    (x0, y0, _), (x1, y1, _) = (
        bounds[:, :3].min(axis=0).tolist(),
        bounds[:, 3:].max(axis=0).tolist(),
    )
    return x0, y0, x1, y1


def spread(
    places: Sequence[tuple[float, float]], number: int, side: float, hull: Box
) -> list[Box]:
    """Return squares around some of the positions, distant from one another and without overlap.

    They are inside ``hull`` if they fit. The first position is the one nearest to the median of
    all positions. Each further position is the farthest from the chosen ones.
    """
    if not places:
        return []
    where = np.array(sorted(set(places)), dtype=np.float64).reshape(-1, 2)
    half = side / 2
    for axis in (0, 1):
        low, high = hull[axis] + half, hull[axis + 2] - half
        if low >= high:
            low = high = (low + high) / 2
        where[:, axis] = np.clip(where[:, axis], low, high)
    distance = np.abs(where - np.median(where, axis=0)).max(axis=1)
    chosen: list[Box] = []
    pick = int(np.argmin(distance))
    nearest = np.full(len(where), np.inf)
    while len(chosen) < number:
        x, y = where[pick].tolist()
        chosen.append((x - half, y - half, x + half, y + half))
        nearest = np.minimum(nearest, np.abs(where - where[pick]).max(axis=1))
        pick = int(np.argmax(nearest))
        if nearest[pick] < side:
            break
    return sorted(chosen)


def _cut(
    guard: ChildProcess,
    sources: Sequence[SourceInfo],
    windows: Sequence[Box],
    scratch: Path,
    salvage: bool,
) -> list[dict[str, str]]:
    """Write files with the points of each window. Return them, with the cloud from which each was cut."""
    files: list[dict[str, str]] = [{} for _ in windows]
    for number, source in enumerate(sources):
        assert source.bounds is not None  # The caller passes only sources with bounds.
        x0, y0, _, x1, y1, _ = source.bounds
        window_indices = [
            i
            for i, w in enumerate(windows)
            if w[0] <= x1 and x0 <= w[2] and w[1] <= y1 and y0 <= w[3]
        ]
        if not window_indices:
            continue
        targets = [str(scratch / f"w{i}-{number}.las") for i in window_indices]
        boxes = [windows[i] for i in window_indices]
        counts = read_in_child(
            guard, cut_windows, source.path, boxes, targets, salvage, source.octree
        )
        for i, path, count in zip(window_indices, targets, counts, strict=True):
            if count:
                files[i][path] = str(source.path)
    if not any(files):
        raise InputError("no window holds a point; give other --windows or a larger --size")
    return files


def _settings(plan: Plan) -> RunConfig:
    """Return the settings of the run of a window, without extent, output and resources of the plan."""
    return plan.config.updated(
        products=("dtm", "dsm"),
        resolution=plan.grid.resolution,
        sheets=None,
        sheet_field=None,
        bounds=None,
        aoi=None,
        store=None,
        scheduler=None,
        workers=1,
        in_process=True,
        overwrite=False,
        force=False,
        clean_store=False,
        salvage=False,
        crs=plan.config.crs or plan.frame.crs_wkt or "none",
    )


def _window(
    bounds: Box, paths: Mapping[str, str], config: RunConfig, listener: Listener
) -> tuple[tuple[Shade, Shade], PreviewWindow]:
    out = Path(next(iter(paths))).with_suffix("")

    def tell(event: Event) -> None:
        """Replace the path of a cut file in a warning by the window and the path of the cloud."""
        if isinstance(event, Warned):
            text = event.text
            for path, cloud in paths.items():
                text = text.replace(
                    path, f"window at x {bounds[0]:.0f}, y {bounds[1]:.0f} of {cloud}"
                )
            event = Warned(text)
        listener(event)

    summary = run(list(paths), out, config, tell, until="grid").summary
    store = open_store(str(out / STORE))
    ground = summary.get("filter", {}).get("ground", summary["counts"]["participating"])
    failed = summary["failed_tasks"]
    for task in failed:
        listener(Warned(f"{task['title']} {task['key']} failed: {task['error']}"))
    window = PreviewWindow(bounds, summary["counts"]["stored"], ground, len(failed))
    return (_shade(store, "dsm"), _shade(store, "dtm")), window


def _shade(store: TileStore, name: str) -> Shade:
    spec = RasterSpec.from_json(store.get_state(f"raster-{name}") or {})
    heights = store.read_block(name, Block(0, 0, spec.height, spec.width)).astype(np.float64)
    heights[heights == NODATA] = np.nan
    frame = store.meta.frame
    step = float(spec.lattice.size * frame.metres_xy / frame.units.vertical)
    shade = multidirectional_hillshade(
        *gradients(np.pad(heights, 1, constant_values=np.nan), step)
    )
    return np.where(np.isnan(shade), EMPTY_GREY, shade).astype(np.uint8)


def _montage(columns: Sequence[Sequence[Shade]]) -> UInt8:
    """Return all pictures on a white background as RGBA. Small pictures are enlarged."""
    largest = max(max(picture.shape) for picture in itertools.chain(*columns))
    times = max(math.ceil(WIDE_PIXELS / largest), 1)
    pictures = [
        [np.kron(p, np.ones((times, times), np.uint8)) for p in column] for column in columns
    ]
    high = [max(column[row].shape[0] for column in pictures) for row in range(2)]
    wide = [max(picture.shape[1] for picture in column) for column in pictures]
    paper = np.full((sum(high) + GAP, sum(wide) + GAP * (len(wide) - 1)), PAPER, np.uint8)
    for row in range(2):
        for number, column in enumerate(pictures):
            top, left = row * (high[0] + GAP), sum(wide[:number]) + number * GAP
            height, width = column[row].shape
            paper[top : top + height, left : left + width] = column[row]
    return np.stack((paper, paper, paper, np.full_like(paper, 255)), axis=-1)
