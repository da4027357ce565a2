"""Surveys of the inputs for the setting ``--priority``, by their days or by a file of the user."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import translate
from glob import escape, has_magic
from pathlib import Path

import numpy as np

from tiler.config import RunConfig
from tiler.core.dates import BY_GPS, Days, days_of, days_text, span_of
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.words import counted, listed
from tiler.errors import ConfigError, InputError
from tiler.inputs import SourceInfo
from tiler.inputs.lists import is_virtual
from tiler.inputs.point_tiles import DATA_FOLDER, is_ept
from tiler.io.foreign_content import excerpt
from tiler.io.locations import is_url, no_such_file, without_query
from tiler.redaction import shown

MAX_DAYS_APART = 30
"""Longest time in days between two files of one survey, if days decide the surveys."""
MAX_FILE_BYTES = 1 << 20
"""Maximum size of a file of surveys in bytes."""
MAX_LISTED = 10
"""Maximum number of surveys in a note, and of warnings about patterns. The others are counted."""
MAX_NAME = 60
"""Maximum number of characters of the name of a survey."""
OTHERS = "other files"
"""Name of the survey of the files that no line takes."""


@dataclass(frozen=True)
class Survey:
    """Survey: a text for the user, its files, and its first and last day, or None if they are not known."""

    name: str
    paths: frozenset[Path]
    days: Days | None

    @property
    def text(self) -> str:
        """Name, days and number of files."""
        days = "" if self.days is None else days_text(self.days)
        facts = [] if days in ("", self.name) else [days]
        return f"{self.name} ({', '.join([*facts, counted(len(self.paths), 'file')])})"


def surveys_of(
    config: RunConfig, paths: Sequence[Path], sources: Sequence[SourceInfo]
) -> tuple[tuple[Survey, ...], list[str], list[str]]:
    """Return the surveys of a run, the one that counts most first, and notes and warnings. All may be empty.

    Parameters
    ----------
    config : RunConfig
    paths : sequence of Path
        All inputs.
    sources : sequence of SourceInfo
        Inputs that can be read.

    Raises
    ------
    ConfigError
        The file of surveys cannot be used, or a file has no date.
    InputError
        There is no file of surveys.
    """
    if config.priority is None:
        return (), [], []
    filled = [source for source in sources if source.points]
    if config.priority_file is None:
        surveys, kind, warnings = _by_days(filled)
    else:
        surveys, warnings = _by_file(Path(config.priority_file), paths, filled)
        kind = ""
    if len(surveys) == 1:
        text = f"--priority {config.priority}: all files are one survey, {surveys[0].text}{kind}: it has no effect"
        return surveys, [], [*warnings, f"{text}; give a FILE with a line per survey"]
    names = listed([survey.text for survey in surveys], MAX_LISTED, "surveys")
    number = counted(len(surveys), "survey")
    note = f"decided: {number}{kind}, the first counts most: {names} (--priority)"
    return surveys, [note], warnings


def visible_share(
    surveys: Sequence[Survey], sources: Sequence[SourceInfo], area: Bounds | None
) -> float:
    """Estimate the share of the points that no survey that counts more covers, 1 without surveys.

    Parameters
    ----------
    surveys : sequence of Survey
        Surveys, the one that counts most first.
    sources : sequence of SourceInfo
        Files with points.
    area : Bounds or None
        Bounds in absolute counts within which points count; None for all points.
    """
    import shapely

    visible, total, hidden = 0.0, 0.0, shapely.Polygon()
    for survey in surveys:
        patches = [p for s in sources if s.path in survey.paths for p in s.patches]
        whole = shapely.box(
            [p.x0 for p in patches],
            [p.y0 for p in patches],
            [p.x1 for p in patches],
            [p.y1 for p in patches],
        )
        # A file whose points lie on a line has no area.
        per_area = [p.points for p in patches] / np.maximum(shapely.area(whole), 1e-9)
        if area is not None:
            whole = shapely.intersection(
                whole, shapely.box(*(v / COUNTS_PER_UNIT for v in area.to_json()))
            )
        total += float(shapely.area(whole) @ per_area)
        visible += float(shapely.area(shapely.difference(whole, hidden)) @ per_area)
        hidden = shapely.union(hidden, shapely.union_all(whole))
    return visible / total if visible else 1.0


def _days_of(sources: Sequence[SourceInfo]) -> tuple[list[Days | None], str]:
    return days_of([(source.times, source.created) for source in sources])


def _by_days(sources: Sequence[SourceInfo]) -> tuple[tuple[Survey, ...], str, list[str]]:
    """Divide files where no file has a day for more than `MAX_DAYS_APART`. The newest survey is first.

    Also return the kind of the days as text, and a warning if a file has too many days, which joins surveys.
    """
    days, by = _days_of(sources)
    paths = [source.path for source in sources]
    known = [(d, path) for d, path in zip(days, paths, strict=True) if d is not None]
    if len(known) < len(paths):
        undated = [str(path) for d, path in zip(days, paths, strict=True) if d is None]
        raise ConfigError(
            f"--priority newest: {listed(undated, 2, 'files')}: no date, neither GPS times in all files nor a day of "
            "creation; give a FILE with a line per survey"
        )
    groups: list[tuple[Days, list[Path]]] = []
    for (first, last), path in sorted(known):
        if groups and (first - groups[-1][0][1]).days <= MAX_DAYS_APART:
            (start, end), files = groups[-1]
            groups[-1] = (start, max(end, last)), [*files, path]
        else:
            groups.append(((first, last), [path]))
    surveys = tuple(
        Survey(days_text(of_group), frozenset(files), of_group)
        for of_group, files in reversed(groups)
    )
    kind = " by GPS time of points" if by == BY_GPS else " by the days in the headers"
    long = [
        f"{path} ({days_text((first, last))})"
        for (first, last), path in known
        if (last - first).days > MAX_DAYS_APART
    ]
    if not long:
        return surveys, kind, []
    text = f"points of more than {MAX_DAYS_APART} days in a file, so that surveys may be joined"
    remedy = "give a FILE with a line per survey"
    return surveys, kind, [f"--priority newest: {listed(long, 2, 'files')}: {text}; {remedy}"]


def _by_file(
    file: Path, paths: Sequence[Path], sources: Sequence[SourceInfo]
) -> tuple[tuple[Survey, ...], list[str]]:
    """Return a survey per line of a file, and one of the inputs that no line takes. Warn about unused patterns."""
    lines = _lines_of(file)
    patterns = _Patterns([text for _, text in lines], os.path.abspath(file.parent))
    taken: list[list[Path]] = [[] for _ in lines]
    others: list[Path] = []
    used: set[int] = set()
    for path in paths:
        taking = patterns.taking(path)
        used |= taking
        claims = sorted({patterns.texts[index][0] for index in taking})
        if len(claims) > 1:
            first, second = (lines[place][0] for place in claims[:2])
            raise ConfigError(
                f"--priority {file}: lines {first} and {second} both take {path}; let one line take it"
            )
        (taken[claims[0]] if claims else others).append(path)
    unused = []
    for index, (place, pattern) in enumerate(patterns.texts):
        if index not in used:
            text = f"--priority {file}: line {lines[place][0]}: no input matches {excerpt(shown(pattern), MAX_NAME)}"
            unused.append(f"{text}; {_remedy(pattern)}")
            if not taken[place]:
                raise ConfigError(unused[-1])
    if more := unused[MAX_LISTED:]:
        number = counted(len(more), "more pattern")
        unused[MAX_LISTED:] = [f"--priority {file}: no input matches {number}; check them"]
    known = {source.path: source for source in sources}
    surveys = []
    for name, of_survey in zip(
        [*(text for _, text in lines), OTHERS], [*taken, others], strict=True
    ):
        readable = [known[path] for path in of_survey if path in known]
        if readable:
            files = frozenset(source.path for source in readable)
            surveys.append(
                Survey(_shortened(shown(name)), files, span_of(_days_of(readable)[0]))
            )
    return tuple(surveys), unused


def _shortened(name: str) -> str:
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME - 3]}..."


def _remedy(pattern: str) -> str:
    if is_virtual(pattern):
        return "give the clouds in the .vpc file, or their folder"
    if pattern.startswith(('"', "'")):
        return "remove the quotes"
    return "give a name, a pattern or a folder of inputs, relative to the folder of this file"


def _lines_of(file: Path) -> list[tuple[int, str]]:
    """Return number and text of each line that is neither empty nor a comment."""
    remedy = "give a text file (UTF-8) with a line per survey, or newest"
    try:
        if not file.exists():
            raise InputError(f"--priority {no_such_file(file, remedy)}")
        if not file.is_file():  # Opening a pipe would wait for its writer.
            raise ConfigError(f"--priority {file}: is not a regular file; {remedy}")
        with file.open("rb") as stream:
            text = stream.read(MAX_FILE_BYTES + 1).decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(
            f"--priority {file}: cannot be read ({error.strerror or error}); {remedy}"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"--priority {file}: is not text in UTF-8; {remedy}") from error
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"--priority {file}: is larger than 1 MiB; {remedy}")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line.strip("; ") and line[0] != "#"]
    if not lines:
        raise ConfigError(f"--priority {file}: has no line; {remedy}")
    return lines


class _Patterns:
    """Patterns of the lines of a file. Those without ``*``, ``?`` and ``[`` are looked up, since there may be many.

    Attributes
    ----------
    texts : list of tuple
        Each pattern, after the place of its line.
    """

    def __init__(self, lines: Sequence[str], folder: str) -> None:
        """Prepare the patterns, which are relative to ``folder`` if they are paths."""
        self.texts = [
            (place, pattern.strip())
            for place, line in enumerate(lines)
            for pattern in line.split(";")
            if pattern.strip()
        ]
        self._indices: dict[str, set[int]] = {}
        """Indices of patterns, by the name or the complete path or URL that each of them is."""
        self._globs: list[tuple[int, re.Pattern[str], re.Pattern[str]]] = []
        """Patterns for paths, and for names and URLs."""
        for index, (_, text) in enumerate(self.texts):
            pattern = without_query(text) if is_url(text) else text
            if is_ept(pattern):
                pattern = f"{pattern[: -len('ept.json')]}{DATA_FOLDER}"
            # A name with brackets may also be complete.
            for whole in (_place(pattern, folder), pattern):
                self._indices.setdefault(os.path.normcase(whole), set()).add(index)
            if has_magic(pattern):
                in_folder = _compiled(_place(pattern, escape(folder)))
                self._globs.append((index, in_folder, _compiled(pattern)))

    def taking(self, path: Path) -> set[int]:
        """Return the indices of the patterns of an input, of its name, or of a folder that contains it."""
        url = is_url(path)
        text = os.path.normcase(without_query(str(path)) if url else os.path.abspath(path))
        name = os.path.basename(text)
        found = set(self._indices.get(name, ()))
        for place in _with_folders(text):
            found |= self._indices.get(place, set())
        found.update(
            index
            for index, in_folder, anywhere in self._globs
            if (anywhere if url else in_folder).match(text) or anywhere.match(name)
        )
        return found


def _place(pattern: str, folder: str) -> str:
    """Return the complete URL or path of a pattern."""
    if is_url(pattern):
        return pattern.rstrip("/")
    return os.path.normpath(os.path.join(folder, pattern))


def _compiled(pattern: str) -> re.Pattern[str]:
    """Return an expression for what a pattern matches, and for all that is in such a folder."""
    pattern = os.path.normcase(pattern)
    return re.compile(f"{translate(pattern)}|{translate(os.path.join(pattern, '*'))}")


def _with_folders(text: str) -> Iterator[str]:
    """Yield a path or URL, and its folders."""
    while text:
        yield text
        folder = os.path.dirname(text)
        text = "" if folder == text else folder
