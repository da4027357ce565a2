"""Surveys of the inputs: by the days of their files, and by the lines of a file."""

from __future__ import annotations

import dataclasses
import os
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.inputs import SourceInfo, inspect
from tiler.io.locations import as_path
from tiler.plan.surveys import Survey, surveys_of

Write = Any


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writer of a cloud with a day of creation and, if they are given, GPS times."""

    def made(name: str, day: date | None, times: list[float] | None = None) -> SourceInfo:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
        header.creation_date = day
        header.global_encoding.gps_time_type = (
            laspy.header.GpsTimeType.STANDARD if times else laspy.header.GpsTimeType.WEEK_TIME
        )
        points = laspy.ScaleAwarePointRecord.zeros(100, header=header)
        points["x"] = points["y"] = np.arange(100.0)
        if times:
            points["gps_time"] = np.resize(times, 100)
        cloud = laspy.LasData(header)
        cloud.points = points
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        cloud.write(path)
        if day is None:  # laspy writes the day of today.
            content = path.read_bytes()
            path.write_bytes(content[:90] + bytes(4) + content[94:])
        return inspect(path)

    return made


Result = tuple[tuple[Survey, ...], list[str], list[str]]


def result(priority: str | Path, sources: list[SourceInfo]) -> Result:
    config = RunConfig.from_mapping({"priority": str(priority)})
    return surveys_of(config, [source.path for source in sources], sources)


def surveys(priority: str | Path, sources: list[SourceInfo]) -> tuple[Survey, ...]:
    return result(priority, sources)[0]


def names(found: tuple[Survey, ...]) -> list[tuple[str, list[str]]]:
    return [(s.name, sorted(path.name for path in s.paths)) for s in found]


def test_files_of_a_chain_of_days_are_one_survey(write: Write) -> None:
    first = date(2019, 3, 1)
    days = [0, 30, 60, 91, 800]  # The fourth file is 31 days after the third.
    files = [write(f"{n}.las", first + timedelta(days=n)) for n in days]
    assert names(surveys("newest", files)) == [
        ("2021-05-09", ["800.las"]),
        ("2019-05-31", ["91.las"]),
        ("2019-03-01 to 2019-04-30", ["0.las", "30.las", "60.las"]),
    ]
    assert surveys("newest", files[::-1]) == surveys("newest", files)


def gps(day: date) -> float:
    """Adjusted standard time: seconds since 1980-01-06, less a thousand million."""
    return (day - date(1980, 1, 6)).days * 86_400 + 3600.0 - 1e9


def test_gps_times_count_more_than_the_header_if_all_files_have_them(write: Write) -> None:
    day = gps(date(2016, 7, 4))
    measured = write("a.las", date(2024, 1, 1), [0.0, day, day + 86_400])
    newer = write("b.las", date(2016, 7, 4), [gps(date(2020, 1, 1))])
    found, notes, warnings = result("newest", [measured, newer])
    assert names(found) == [
        ("2020-01-01", ["b.las"]),
        ("2016-07-04 to 2016-07-05", ["a.las"]),
    ]
    assert found[1].days == (date(2016, 7, 4), date(2016, 7, 5))
    assert notes[0].startswith("decided: 2 surveys by GPS time of points, the first")
    assert not warnings


WEEK = [3600.0, 500_000.0]
"""Seconds of a week, which as adjusted standard times would be in September 2011."""


@pytest.mark.parametrize(
    "times", [None, WEEK, [gps(date(1985, 1, 1))], [gps(date(2500, 1, 1))]]
)
def test_headers_count_if_a_file_has_no_valid_gps_times(
    write: Write, times: list[float] | None
) -> None:
    files = [
        write("a.las", date(2024, 1, 1), [gps(date(2016, 7, 4))]),
        write("b.las", date(2020, 1, 1), times),
    ]
    found, notes, _ = result("newest", files)
    assert names(found) == [("2024-01-01", ["a.las"]), ("2020-01-01", ["b.las"])]
    assert notes[0].startswith("decided: 2 surveys by the days in the headers, the first")


def test_one_wrong_time_does_not_join_surveys(write: Write) -> None:
    old, new = gps(date(2015, 5, 1)), gps(date(2023, 5, 1))
    files = [write("a.las", date(2024, 1, 1), [old]), write("b.las", date(2024, 1, 1), [new])]
    wrong = write("c.las", date(2024, 1, 1), [old, *[new] * 99])
    found, _, warnings = result("newest", [*files, wrong])
    assert names(found) == [("2023-05-01", ["b.las", "c.las"]), ("2015-05-01", ["a.las"])]
    assert not warnings


def test_a_file_of_two_surveys_is_a_warning(write: Write) -> None:
    old, new = gps(date(2015, 5, 1)), gps(date(2023, 5, 1))
    files = [write("a.las", None, [old]), write("both.las", None, [old, new])]
    found, notes, warnings = result("NEWEST", files)
    assert len(found) == 1
    assert not notes
    assert "both.las (2015-05-01 to 2023-05-01): points of more than 30 days" in warnings[0]
    assert warnings[1].startswith(
        "--priority NEWEST: all files are one survey, 2015-05-01 to 2023-05-01 (2 files) by GPS"
    )
    assert warnings[1].endswith("it has no effect; give a FILE with a line per survey")


def test_a_file_without_a_day_is_an_error(write: Write) -> None:
    files = [write("a.las", date(2020, 1, 1)), write("b.las", None)]
    with pytest.raises(ConfigError, match=r"newest: .*b\.las: no date.*; give a FILE"):
        surveys("newest", files)


def test_lines_have_names_patterns_and_folders(write: Write, tmp_path: Path) -> None:
    day = date(2020, 1, 1)
    paths = ["2015/a.las", "2015/b.las", "c_2023.las", "d[1].las", "e.las"]
    files = [write(name, day) for name in paths]
    lines = tmp_path / "lists" / "surveys.txt"
    lines.parent.mkdir()
    lines.write_text("# newest first\n\n *_2023.las ; ../d[1].las\n../2015\n", "utf-8-sig")
    assert names(surveys(lines, files)) == [
        ("*_2023.las ; ../d[1].las", ["c_2023.las", "d[1].las"]),
        ("../2015", ["a.las", "b.las"]),
        ("other files", ["e.las"]),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a.las\nx*.las\n", r"surveys.txt: line 2: no input matches 'x\*.las'; give"),
        ("a.las\n*.las\n", r"surveys.txt: lines 1 and 2 both take .*a\.las; let one line"),
        ("# nothing\n", r"surveys.txt: has no line; give"),
        (b"\xff\xfe\x00", r"surveys.txt: is not text in UTF-8; give"),
        (
            "a.las; list.vpc\nx.vpc\n",
            r"surveys.txt: line 2: .*; give the clouds in the .vpc file",
        ),
        ("'a.las'\n", r"surveys.txt: line 1: no input matches \"'a.las'\"; remove the quotes"),
        (f"{'x' * 90}; y", r"surveys.txt: line 1: no input matches 'x{59}\.\.\.; give"),
    ],
)
def test_a_bad_file_is_one_clear_line(
    write: Write, tmp_path: Path, text: str | bytes | None, message: str
) -> None:
    files = [write(name, date(2020, 1, 1)) for name in ("a.las", "b.las")]
    lines = tmp_path / "surveys.txt"
    if text is not None:
        lines.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError, match=f"^--priority .*{message}"):
        surveys(lines, files)


def test_only_a_regular_file_is_read(write: Write, tmp_path: Path) -> None:
    files = [write("a.las", date(2020, 1, 1))]
    with pytest.raises(
        InputError, match=r"^--priority .*surveys\.txt: no such file; give a text file"
    ):
        surveys(tmp_path / "surveys.txt", files)
    with pytest.raises(
        InputError, match=r"^--priority https://x/s\.txt: .* not read from a URL; download"
    ):
        surveys("https://x/s.txt", files)
    with pytest.raises(ConfigError, match="is not a regular file; give a text file"):
        surveys(tmp_path, files)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_not_opened(write: Write, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="pipe: is not a regular file"):
        surveys(tmp_path / "pipe", [write("a.las", date(2020, 1, 1))])


def test_each_pattern_without_an_input_is_a_warning(write: Write, tmp_path: Path) -> None:
    files = [write(name, date(2020, 1, 1)) for name in ("a.las", "b.las")]
    lines = tmp_path / "surveys.txt"
    lines.write_text("a.las; c*.las\nd.vpc; b.las;\n")
    _, _, warnings = result(lines, files)
    assert [text.partition("; ")[0] for text in warnings] == [
        f"--priority {lines}: line 1: no input matches 'c*.las'",
        f"--priority {lines}: line 2: no input matches 'd.vpc'",
    ]
    lines.write_text("a.las;" + ";".join(f"x{n}" for n in range(14)) + "\nb.las")
    _, _, warnings = result(lines, files)
    assert len(warnings) == 11
    assert "no input matches 4 more patterns" in warnings[-1]


def test_urls_match_with_and_without_their_queries(write: Write, tmp_path: Path) -> None:
    texts = ["https://x/2015/a.laz?sig=1", "https://x/2023/b.laz?sig=2", "https://x/2023/c.laz"]
    file = write("a.las", date(2020, 1, 1))
    files = [dataclasses.replace(file, path=as_path(text)) for text in texts]
    lines = tmp_path / "surveys.txt"
    for first in ("https://x/2015/a.laz?sig=other", "a.laz", "https://x/2015/", "*/2015/*"):
        lines.write_text(f"{first}\nhttps://x/2023/[bc].laz\n")
        newer, older = surveys(lines, files)
        assert newer.paths == {files[0].path}
        assert older.paths == {files[1].path, files[2].path}
        assert newer.name == first.partition("?")[0]


def test_a_line_with_point_tiles_takes_their_nodes(write: Write, tmp_path: Path) -> None:
    for folder in ("tiles", "tiles/ept-data"):
        (tmp_path / folder).mkdir()
    files = [write(name, date(2020, 1, 1)) for name in ("tiles/ept-data/0-0-0-0.las", "b.las")]
    lines = tmp_path / "surveys.txt"
    lines.write_text("tiles/ept.json")
    assert names(surveys(lines, files)) == [
        ("tiles/ept.json", ["0-0-0-0.las"]),
        ("other files", ["b.las"]),
    ]


def test_a_long_name_of_a_survey_is_shortened(write: Write, tmp_path: Path) -> None:
    lines = tmp_path / "surveys.txt"
    lines.write_text("a.las; " * 10)
    assert surveys(lines, [write("a.las", date(2020, 1, 1))])[0].name == "a.las; " * 8 + "a..."
