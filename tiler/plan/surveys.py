"""Surveys of the inputs for the setting ``--priority``, by their days or by a file of the user."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from tiler.config import RunConfig
from tiler.core.dates import Days, dates_of_gps, dates_of_header, days_text
from tiler.core.words import counted, listed
from tiler.errors import ConfigError
from tiler.inputs import SourceInfo
from tiler.io.locations import is_url, without_query

MAX_DAYS_APART = 30
"""Longest time in days between two files of one survey, if days decide the surveys."""
MAX_FILE_BYTES = 1 << 20
"""Maximum size of a file of surveys in bytes."""
MAX_LISTED = 10
"""Maximum number of surveys in a note. The others are counted."""
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
) -> tuple[tuple[Survey, ...], list[str]]:
    """Return the surveys of a run, the one that counts most first, and a note about them. Both may be empty.

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
    """
    if config.priority is None:
        return (), []
    days = {source.path: _days_of(source) for source in sources if source.points}
    if config.priority_file is None:
        surveys = _by_days(days)
    else:
        surveys = _by_file(Path(config.priority_file), paths, days)
    names = listed([survey.text for survey in surveys], MAX_LISTED, "surveys")
    number = counted(len(surveys), "survey")
    return surveys, [f"decided: {number}, the first counts most: {names} (--priority)"]


def _days_of(source: SourceInfo) -> Days | None:
    return dates_of_gps(source.times) or dates_of_header(source.created)


def _by_days(days: dict[Path, Days | None]) -> tuple[Survey, ...]:
    """Divide files where no file has a day for more than `MAX_DAYS_APART`. The newest survey is first."""
    if undated := [str(path) for path, of_file in days.items() if of_file is None]:
        raise ConfigError(
            f"--priority newest: {listed(undated, 2, 'files')}: no date, neither GPS times nor a day of creation; give "
            "a FILE with a line per survey"
        )
    groups: list[tuple[Days, list[Path]]] = []
    known = ((of_file, path) for path, of_file in days.items() if of_file is not None)
    for (first, last), path in sorted(known):
        if groups and (first - groups[-1][0][1]).days <= MAX_DAYS_APART:
            (start, end), files = groups[-1]
            groups[-1] = (start, max(end, last)), [*files, path]
        else:
            groups.append(((first, last), [path]))
    return tuple(
        Survey(days_text(of_group), frozenset(files), of_group)
        for of_group, files in reversed(groups)
    )


def _by_file(
    file: Path, paths: Sequence[Path], days: dict[Path, Days | None]
) -> tuple[Survey, ...]:
    """Return a survey per line of a file, and one of the inputs that no line takes."""
    lines = _lines_of(file)
    taken: list[list[Path]] = [[] for _ in lines]
    others: list[Path] = []
    for path in paths:
        claims = [
            number
            for number, (_, line) in enumerate(lines)
            if any(_takes(pattern.strip(), path, file) for pattern in line.split(";"))
        ]
        if len(claims) > 1:
            first, second = (lines[number][0] for number in claims[:2])
            raise ConfigError(
                f"--priority {file}: lines {first} and {second} both take {path}; let one line take it"
            )
        (taken[claims[0]] if claims else others).append(path)
    for (number, line), of_line in zip(lines, taken, strict=True):
        if not of_line:
            raise ConfigError(
                f"--priority {file}: line {number}: no input matches {line!r}; give a name, a pattern or a folder of "
                "inputs, relative to the folder of this file"
            )
    names = [*(line for _, line in lines), OTHERS]
    surveys = (
        _survey(name, of_survey, days)
        for name, of_survey in zip(names, [*taken, others], strict=True)
    )
    return tuple(survey for survey in surveys if survey.paths)


def _survey(name: str, paths: Sequence[Path], days: dict[Path, Days | None]) -> Survey:
    """Return the survey of those paths that can be read. It has days if all of its files have."""
    readable = frozenset(path for path in paths if path in days)
    known = [of_file for path in readable if (of_file := days[path]) is not None]
    if not known or len(known) < len(readable):
        return Survey(name, readable, None)
    return Survey(
        name, readable, (min(first for first, _ in known), max(last for _, last in known))
    )


def _lines_of(file: Path) -> list[tuple[int, str]]:
    """Return number and text of each line that is neither empty nor a comment."""
    remedy = "give a text file (UTF-8) with a line per survey, or newest"
    try:
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
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    if not lines:
        raise ConfigError(f"--priority {file}: has no line; {remedy}")
    return lines


def _takes(pattern: str, path: Path, file: Path) -> bool:
    """Return whether a pattern is that of an input, of its name, or of a folder that contains it."""
    if not pattern:
        return False
    if is_url(path):
        text = without_query(str(path))
        wanted, inside = pattern, f"{pattern.rstrip('/')}/*"
    else:
        text, folder = os.path.abspath(path), os.path.abspath(file.parent)
        if text == os.path.normpath(os.path.join(folder, pattern)):
            return True  # A name with brackets is not a pattern.
        wanted = os.path.normpath(os.path.join(glob.escape(folder), pattern))
        inside = os.path.join(wanted, "*")
    return any(fnmatch(text, known) for known in (wanted, inside)) or fnmatch(
        os.path.basename(text), pattern
    )
