"""The log on stderr, as detailed as -v and -q say."""

from __future__ import annotations

import logging
import warnings

import pytest

from tiler.observe.json_lines import set_up_logging

pytestmark = pytest.mark.usefixtures("logging_as_before")


@pytest.mark.parametrize(
    ("verbosity", "shown"),
    [
        (-2, {"error"}),
        (-1, {"error"}),
        (0, {"error", "warning"}),
        (1, {"error", "warning", "info"}),
        (2, {"error", "warning", "info", "debug"}),
        (5, {"error", "warning", "info", "debug"}),
    ],
)
def test_levels(verbosity: int, shown: set[str], capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging(verbosity)
    logger = logging.getLogger("tiler.somewhere")
    for name in ("debug", "info", "warning", "error"):
        getattr(logger, name)("text of %s", name)
    captured = capsys.readouterr()
    assert {line.rsplit(" ", 1)[1] for line in captured.err.splitlines()} == shown
    assert captured.out == ""


def test_libraries_are_quieter_than_tiler(capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging(1)
    logging.getLogger("rasterio").info("opened")
    assert capsys.readouterr().err == ""
    set_up_logging(2)
    logging.getLogger("rasterio").info("opened")
    logging.getLogger("rasterio").debug("detail")
    assert capsys.readouterr().err == "INFO rasterio: opened\n"


def test_logging_set_up_twice_writes_each_message_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    set_up_logging(0)
    set_up_logging(0)
    logging.getLogger("tiler").warning("once")
    assert capsys.readouterr().err == "WARNING: once\n"


def test_warnings_of_libraries_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging(0)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        logging.captureWarnings(True)
        warnings.warn("first\nsecond", UserWarning, stacklevel=1)
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "UserWarning: first second" in error
