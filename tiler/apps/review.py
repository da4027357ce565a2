"""Command `tiler review`: the first places to review of a run as cards of one page, on which the user decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyproj import CRS

from tiler.apps.check import terrain_in
from tiler.apps.evaluate.rasters import raster_named
from tiler.core.crs import split
from tiler.core.words import counted
from tiler.errors import ConfigError, InputError
from tiler.io.locations import is_url
from tiler.io.overwrite_check import same_file
from tiler.io.result_folder import REVIEW, REVIEW_PAGE, give_results, read_run, store_of
from tiler.io.vector import CUT
from tiler.report.cards import card, decisions
from tiler.report.document import el, page, section, validate_page
from tiler.report.places import Detail, OpenPlaces, read_open_places
from tiler.report.runfile import units_of, write_whole
from tiler.schedule import call_isolated, half_of_memory

SECONDS, SECONDS_PER_PLACE = 60.0, 20.0
"""Time that reading may take. It takes 0.1 to 2 s per place."""
MAKER = "tiler review"


@dataclass(frozen=True)
class ReviewPage:
    """Page that was written: its path, and numbers of places shown and open."""

    page: str
    shown: int
    open: int


def write_review_page(
    out: str | Path,
    places: int = 50,
    page_path: str | Path | None = None,
    store_url: str | None = None,
) -> ReviewPage:
    """Write a page with a card for each of the first open places of a run, or one that says that none is open.

    Parameters
    ----------
    out : path
        Folder of the run.
    places : int
        Largest number of cards.
    page_path : path, optional
        File of the page. The default is ``review.html`` in ``out``.
    store_url : str, optional
        Location of the store, whose points the sections show. The default is the one in the ``run.json``, or
        ``store.zarr`` in the folder.

    Raises
    ------
    ConfigError
        The folder or the page cannot be used.
    InputError
        The folder has no results with places to review, or a file cannot be read.
    ProcessingError
        The page cannot be written.
    """
    run = run_in(out)
    source = Path(out, REVIEW)
    target = Path(out, REVIEW_PAGE) if page_path is None else Path(page_path)
    validate_page(target, [source], MAKER)
    if not source.is_file():
        raise InputError(f"{source}: no such file; run again, which lists the places to review")
    dtm, edits = terrain_in(str(out)), _other_edits(run, source)
    with raster_named(dtm):
        found = call_isolated(
            read_open_places,
            source,
            dtm,
            run,
            store_of(out, run, store_url),
            Detail(places),
            edits,
            paths=(source, Path(dtm), *([edits] if edits else [])),
            memory_bytes=half_of_memory(),
            seconds=SECONDS + SECONDS_PER_PLACE * places,
            remedy="give fewer places with --places",
            smaller=CUT,
        )
    write_whole(target, _page(Path(out), run, found))
    return ReviewPage(str(target), len(found.cards), found.number)


def run_in(out: str | Path) -> dict[str, Any]:
    """Return the content of run.json in a folder. Raise an error if there is none, or the folder is at a URL."""
    if is_url(str(out)):
        raise ConfigError(f"{out}: is a URL; give a copy on this machine")
    run = read_run(str(out))
    if run is None or not isinstance(run.get("plan"), dict):
        raise InputError(f"{out}: has no results of a run; {give_results(out)}")
    return run


def _other_edits(run: Mapping[str, Any], source: Path) -> Path | None:
    """Return the file of edits that the run used, if it is another than that of the places.

    Raise InputError if it is not there, since a saved file without its edits would undo them.
    """
    named = (run.get("configuration") or {}).get("edits")
    if not isinstance(named, str):
        return None
    path = Path(named)
    if not path.is_file():
        raise InputError(
            f"{named}: the edits of the run are not there, so a file of decisions would undo them; call from the "
            "folder of the run, or run again with other edits"
        )
    return None if same_file(named, str(source)) else path


def _page(out: Path, run: Mapping[str, Any], found: OpenPlaces) -> bytes:
    cards, number, crs = found.cards, found.number, crs_name_in_geojson(found.crs)
    title = f"Places to review of {out.resolve().name}"
    written = f"of the run written {run.get('written', 'at an unknown time')} (UTC)"
    if not number:
        text = f"No place {written} is open."
        header = el("header", el("h1", title), el("p", text, class_="lead"))
        return page(title, header, [], maker=MAKER)
    text = (
        f"{counted(number, 'place')} {written} "
        f"{'is' if number == 1 else 'are'} open, the most serious first. "
        "Decide on each, save the decisions, and run again with --edits and the saved file."
    )
    if found.kept:
        text += f" It also has the {counted(len(found.kept), 'earlier decision')}."
    keys = "Keys: n next, p previous, o right, f change it, u open, s save."
    header = el(
        "header",
        el("h1", title),
        el("p", text, class_="lead"),
        el("p", keys, class_="quiet") if crs else None,
    )
    bar = el(
        "div",
        el("output", f"0 of {len(cards)} decided", id="decided"),
        el("button", "Save decisions", id="save", type="button"),
        el("output", "", id="saved"),
        class_="saving",
    )
    if crs is None:
        bar = el(
            "p",
            "The clouds have no CRS, without which this page cannot save polygons: decide in review.gpkg.",
            class_="warning",
        )
    places = section(
        "places",
        "Places",
        bar,
        *(
            card(number, place, run, units_of(run), crs is not None)
            for number, place in enumerate(cards, start=1)
        ),
    )
    return page(
        title,
        header,
        [places],
        decisions(cards, found.kept, crs),
        ("cards.js", "review.js"),
        MAKER,
    )


def crs_name_in_geojson(crs: str | None) -> str | None:
    """Return the name of a CRS for a GeoJSON file: its code if it has one, else its WKT."""
    if crs is None:
        return None
    horizontal = split(CRS.from_user_input(crs))[0]
    if horizontal is None:
        return None
    code = horizontal.to_authority(min_confidence=100)
    return ":".join(code) if code else str(horizontal.to_wkt())
