"""`tiler review --statement`: the statement on a run's terrain, and the page with the squares to look at next."""

from __future__ import annotations

import math
import os
import shlex
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiler.apps.check import terrain_in
from tiler.apps.evaluate.rasters import BLOCK, open_raster, raster_named
from tiler.apps.review import SECONDS, SECONDS_PER_PLACE, run_in
from tiler.apps.statement.sample import SHARES, Sample, draws_needed, read_answers, sample_of
from tiler.apps.statement.squares import OPENING_M, Squares, Terrain
from tiler.core.betting import DOUBT
from tiler.core.records import new_digest
from tiler.core.units import area_text, length_text, small_area_text
from tiler.core.words import counted
from tiler.errors import ConfigError, InputError
from tiler.io.cloud_reading import BLOCK_BYTES
from tiler.io.locations import is_url
from tiler.io.result_folder import STATEMENT_PAGE, store_of
from tiler.io.vector import Feature
from tiler.report.cards import Card, views
from tiler.report.document import el, page, section, validate_page
from tiler.report.places import Detail, open_survey, place_card
from tiler.report.runfile import units_of, write_whole
from tiler.schedule import call_isolated, half_of_memory

MAKER = "tiler review --statement"
SECONDS_PER_BLOCK = 20.0
"""Time that the search of a block of pixels may take. It takes 1 s with pixels of 1 m, and 3 s with pixels of 0.1 m."""
MIN_PIXEL_M, MAX_PIXEL_M = 0.1, 5.0
"""Sides of pixels for which a statement is made."""
AROUND_M = 10.0
"""Land around a square, to which the picture adds more."""


OBJECT_M = 1.0
"""Least height of the objects of a statement."""


@dataclass(frozen=True)
class Statement:
    """Statement on the objects left in a terrain, and the page that was written.

    Attributes
    ----------
    text : str
        Statement as a sentence.
    max_m2 : float or None
        Upper bound of the area of the objects in square metres. None if no terrain rises.
    confidence : float
        Least probability with which the bound holds.
    terrain_m2, rising_m2 : float
        Areas of the terrain, and of what rises above the land around.
    draws, with_objects, waiting : int
        Numbers of draws that count, of those with an object, and of answers that do not count yet.
    squares, seen : int
        Numbers of squares with rising terrain, and of those with an answer.
    page : str
        Path of the page with the next squares, or an empty text if there are none.
    shown : int
        Number of squares in the page.
    """

    text: str
    max_m2: float | None
    confidence: float
    terrain_m2: float
    rising_m2: float
    draws: int
    with_objects: int
    waiting: int
    squares: int
    seen: int
    page: str
    shown: int


def write_statement(
    out: str | Path,
    places: int = 50,
    page_path: str | Path | None = None,
    store_url: str | None = None,
    answers: str | Path | None = None,
) -> Statement:
    """Return the statement on the objects left in a run's terrain, and write a page with the next squares to look at.

    Parameters
    ----------
    out : path
        Folder of the run.
    places : int
        Largest number of squares in the page.
    page_path : path, optional
        File of the page. The default is ``statement.html`` in ``out``.
    store_url : str, optional
        Location of the store, see `tiler.apps.review.write_review_page`.
    answers : path, optional
        File of answers that an earlier page saved.

    Raises
    ------
    ConfigError
        The folder or the page cannot be used.
    InputError
        The folder has no terrain, the answers are damaged or are of another terrain, or a file cannot be read.
    ProcessingError
        The page cannot be written.
    """
    if is_url(str(answers or "")):
        raise ConfigError(f"--answers {answers}: is a URL; give a copy on this machine")
    run = run_in(out)
    dtm = terrain_in(str(out))
    target = Path(out, STATEMENT_PAGE) if page_path is None else Path(page_path)
    validate_page(target, [dtm] if answers is None else [dtm, answers], MAKER)
    given = None if answers is None else read_answers(Path(answers))
    with open_raster(dtm) as raster:
        blocks = (raster.width // BLOCK + 1) * (raster.height // BLOCK + 1)
    with raster_named(dtm):
        found = call_isolated(
            _read,
            dtm,
            run,
            store_of(out, run, store_url),
            Detail(places),
            given,
            paths=(Path(dtm),),
            memory_bytes=half_of_memory(),
            seconds=SECONDS + SECONDS_PER_PLACE * places + SECONDS_PER_BLOCK * blocks,
            remedy="give fewer squares with --places",
            smaller="use a machine with more memory",
        )
    if found is None:
        raise InputError(
            f"{answers}: its answers are of another terrain; give those of this run, or begin without --answers"
        )
    statement = _statement(run, found, str(target))
    # A page without squares replaces an earlier one, whose statement is out of date.
    if statement.page or (found.sample is not None and target.exists()):
        again = _command(out, page_path, store_url)
        write_whole(target, _page(Path(out), run, found, statement.text, again))
    return statement


@dataclass(frozen=True)
class _Found:
    """Counted squares, side of a pixel in metres, key of the draws, earlier answers, sample, and cards by draw."""

    squares: Squares
    pixel_m: float
    key: str
    answers: Mapping[int, float]
    sample: Sample | None
    cards: Mapping[int, Card]


def _read(
    dtm: str,
    run: Mapping[str, Any],
    store_url: str,
    detail: Detail,
    given: tuple[str, Mapping[int, float]] | None,
) -> _Found | None:
    """Return what the statement and its page need, or None if the answers are of another terrain."""
    wide, high = units_of(run)
    with open_survey(dtm, run, store_url, detail) as survey:
        pixel_m = abs(survey.terrain.transform.a) * wide
        _validate_pixel(dtm, pixel_m, wide)
        terrain = Terrain(survey.terrain, pixel_m, high)
        squares = terrain.squares()
        key = squares.digest(_terrain_digest(survey.terrain))
        if given is not None and given[0] != key:
            return None
        answers = {} if given is None else given[1]
        if not squares.pixels:
            raise InputError(f"{dtm}: has no heights, so there is nothing to state; run again")
        if not squares.rising.size:
            return _Found(squares, pixel_m, key, answers, None, {})
        sample = sample_of(squares, key, answers, detail.places)
        cards = {}
        for index, draw in sample.todo.items():
            outline, square = terrain.outline(squares, index)
            around = square.buffer(AROUND_M / wide).bounds
            cards[draw] = place_card(Feature("", outline, {}), survey, around)
    return _Found(squares, pixel_m, key, answers, sample, cards)


def _validate_pixel(dtm: str, pixel_m: float, wide: float) -> None:
    """Raise InputError if the windows have too many pixels for the memory, or an object is smaller than a pixel."""
    if not MIN_PIXEL_M <= pixel_m <= MAX_PIXEL_M:
        sizes = f"{length_text(MIN_PIXEL_M, wide)} to {length_text(MAX_PIXEL_M, wide)}"
        raise InputError(
            f"{dtm}: has pixels of {length_text(pixel_m, wide)}, and a statement needs {sizes}; run with another "
            "--resolution into another OUT"
        )


def _terrain_digest(raster: Any) -> str:
    """Return a digest of the terrain's GeoTIFFs. The draws follow from it, so that nothing else chooses them."""
    digest = new_digest()
    for name in sorted(raster.files):
        # Programs that open a raster may write statistics beside it.
        if Path(name).suffix.lower() in (".tif", ".tiff"):
            with open(name, "rb") as stream:
                while part := stream.read(BLOCK_BYTES):
                    digest.update(part)
    return digest.hexdigest()


def _statement(run: Mapping[str, Any], found: _Found, target: str) -> Statement:
    squares, sample, pixel_m2 = found.squares, found.sample, found.pixel_m**2
    rising = squares.all_rising
    shares = () if sample is None else sample.shares
    return Statement(
        text=statement_text(sample, squares.pixels, rising, pixel_m2, units_of(run)),
        max_m2=None if sample is None else sample.max_pixels * pixel_m2,
        confidence=1 - DOUBT,
        terrain_m2=squares.pixels * pixel_m2,
        rising_m2=rising * pixel_m2,
        draws=len(shares),
        with_objects=sum(share > 0 for share in shares),
        waiting=0 if sample is None else sample.waiting,
        squares=squares.rising.size,
        seen=0 if sample is None else sample.seen,
        page=target if found.cards else "",
        shown=len(found.cards),
    )


def _command(out: str | Path, page_path: str | Path | None, store_url: str | None) -> str:
    """Return the command that reads the answers, as the user can type it."""
    words = ["tiler", "review", str(out), "--statement", "--answers", "FILE"]
    words += [] if page_path is None else ["--page", str(page_path)]
    words += [] if store_url is None else ["--store", store_url]
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


def _page(out: Path, run: Mapping[str, Any], found: _Found, text: str, again: str) -> bytes:
    title = f"Random squares of {out.resolve().name}"
    header = el(
        "header",
        el("h1", title),
        el("p", f"{text[0].upper()}{text[1:]}.", class_="lead"),
        el(
            "p",
            f"Run written {run.get('written', 'at an unknown time')} (UTC).",
            class_="quiet",
        ),
        el(
            "p",
            "The red outline has the terrain of a square that rises above the land around. Answer how much of the "
            f"outlined area is an object, save the answers, and call with the saved file: {again}",
        ),
        el(
            "p", "Keys: n next, p previous, 0 to 4 answer, u no answer, s save.", class_="quiet"
        ),
    )
    bar = el(
        "div",
        el("output", f"0 of {len(found.cards)} answered", id="decided"),
        el("button", "Save answers", id="save", type="button"),
        el("output", "", id="saved"),
        class_="saving",
    )
    cards = [_card(draw, card, run) for draw, card in sorted(found.cards.items())]
    data = {
        "sample": found.key,
        "answers": found.answers,
        "draws": sorted(found.cards),
        "shares": list(SHARES.values()),
    }
    squares = section("squares", "Squares", bar, *cards)
    return page(title, header, [squares], data, ("cards.js", "statement.js"), MAKER)


def _card(draw: int, place: Card, run: Mapping[str, Any]) -> Any:
    choices = [
        el(
            "label",
            el("input", type="radio", name=f"share-{draw}", value=key),
            f" {text} ({key})",
        )
        for key, text in enumerate(SHARES)
    ]
    x, y = place.middle
    question = (
        "How much of the outlined area is an object (building, plant, vehicle) "
        "that does not belong to the terrain?"
    )
    return el(
        "article",
        el("h3", f"Square of draw {draw}"),
        el("p", f"middle {x:.1f}, {y:.1f}", class_="quiet"),
        views(place, run, units_of(run)),
        el("fieldset", el("legend", question), *choices),
        class_="place",
        id=f"square-{draw}",
        tabindex=-1,
    )


def rounded_up(number: float) -> int:
    """Return a number rounded up to two digits."""
    step = 10 ** max(math.floor(math.log10(number)) - 1, 0) if number > 0 else 1
    return math.ceil(number / step) * step


def statement_text(
    sample: Sample | None, pixels: int, rising: int, pixel_m2: float, units: tuple[float, float]
) -> str:
    """Return the sentence on the objects left in a terrain.

    Parameters
    ----------
    sample : Sample or None
        None if no pixel rises.
    pixels, rising : int
        Numbers of pixels with a height, and of those that rise.
    pixel_m2 : float
        Area of a pixel in square metres.
    units : (float, float)
        Metres in a unit of the coordinates, and in one of the heights.
    """
    wide, high = units
    objects = (
        f"objects that rise by {length_text(OBJECT_M, high)} or more, "
        f"up to {length_text(OPENING_M, wide)} wide, are left"
    )
    land = f"{area_text(pixels * pixel_m2, wide)} of terrain"
    if sample is None:
        return f"no square to look at: none of {land} rises above the land around"
    rises = f"{small_area_text(rising * pixel_m2, wide)} rises above the land around"
    later = f"; {counted(sample.waiting, 'later answer')} will count once all squares before are answered"
    if not sample.shares:
        begin = f"no answer counts yet: of {land}, {rises}; "
        return begin + _needed(sample, rising * pixel_m2, wide) + later * bool(sample.waiting)
    bound = small_area_text(rounded_up(sample.max_pixels * pixel_m2 / wide**2) * wide**2, wide)
    if sample.seen == sample.squares:
        basis = f"as every square that rises was looked at ({sample.squares:,})"
    else:
        with_objects = sum(share > 0 for share in sample.shares)
        number = counted(len(sample.shares), "random draw")
        basis = f"95 % sure ({number}, {with_objects:,} with objects)"
    text = f"at most {bound} of {objects} in {land}, of which {rises}, {basis}"
    return text + later * bool(sample.waiting)


def _needed(sample: Sample, rising_m2: float, wide: float) -> str:
    """Return how many squares without an object give round bounds."""
    rising = rising_m2 / wide**2
    power = math.ceil(math.log10(rising)) - 1
    bounds = []
    for bound in (10**power, 10 ** (power - 1)):
        needed = draws_needed(bound / rising)
        if bound >= 1 and needed < sample.squares:
            bounds.append(f"{needed:,} for at most {small_area_text(bound * wide**2, wide)}")
    if not bounds:
        return f"look at {'the square' if sample.squares == 1 else f'all {sample.squares:,} squares'}"
    return f"draws without an object that are needed, 95 % sure: {', '.join(bounds)}"
