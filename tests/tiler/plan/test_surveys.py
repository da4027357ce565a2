"""Surveys of the inputs: by the days of their files, and by the lines of a file."""

from __future__ import annotations

from datetime import date, timedelta
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.inputs import SourceInfo, inspect
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


def surveys(priority: str | Path, sources: list[SourceInfo]) -> tuple[Survey, ...]:
    config = RunConfig.from_mapping({"priority": str(priority)})
    return surveys_of(config, [source.path for source in sources], sources)[0]


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


def test_gps_times_count_more_than_the_header(write: Write) -> None:
    # Adjusted standard times: seconds since 1980-01-06, less a thousand million.
    day = (date(2016, 7, 4) - date(1980, 1, 6)).days * 86_400 + 3600.0 - 1e9
    measured = write("a.las", date(2024, 1, 1), [0.0, day, day + 86_400])
    made = write("b.las", date(2020, 1, 1))
    found = surveys("newest", [measured, made])
    assert names(found) == [
        ("2020-01-01", ["b.las"]),
        ("2016-07-04 to 2016-07-05", ["a.las"]),
    ]
    assert found[1].days == (date(2016, 7, 4), date(2016, 7, 5))


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
        (None, r"surveys.txt: cannot be read \(No such file or directory\); give"),
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
