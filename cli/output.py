"""Output of results to stdout: JSON, tables (rich on a terminal, plain elsewhere) and lines of facts.

Standard output and error may lose their reader without an error (``tiler ... | head``).
"""

from __future__ import annotations

import codecs
import errno
import io
import json
import os
import sys
from bisect import bisect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any, TextIO

import click

from tiler.errors import write_error
from tiler.redaction import shown, stored, without_secrets

SHARES = (0.3, 0.75, 1.5)
"""Upper limits of the shades of a map, as shares of the median density."""


def write_line(line: str, error: bool = False) -> None:
    """Write one line to stdout or stderr.

    All output except tables on a terminal passes through this function, because it may contain
    names and texts from files. It escapes control sequences of the terminal, and hides
    passwords and tokens in URLs.
    """
    encoding = (sys.stderr if error else sys.stdout).encoding or "utf-8"
    click.echo(shown(line).encode(encoding, "backslashreplace").decode(encoding), err=error)


def write_lines(lines: Iterable[str]) -> None:
    """Write lines to stdout, see `write_line`."""
    for line in lines:
        write_line(line)


def print_result(result: Any, as_json: bool, lines: Iterable[str]) -> None:
    """Write the fields of a dataclass to stdout as JSON, or lines that tell of it."""
    if as_json:
        print_json(asdict(result))
    else:
        write_lines(lines)


def print_json(value: Any) -> None:
    """Write indented JSON.

    Characters that cannot be printed are escaped. If stdout is not UTF-8, all characters beyond
    ASCII are escaped.
    """
    # JSON must be UTF-8
    is_utf8 = codecs.lookup(sys.stdout.encoding or "utf-8").name == "utf-8"
    text = json.dumps(
        stored(value),
        indent=2,
        default=lambda v: without_secrets(str(v)),
        ensure_ascii=not is_utf8,
    )
    for line in text.split("\n"):
        write_line("".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in line))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a table with a heading: wrapped by rich on a terminal, aligned and not wrapped elsewhere."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        table = Table(*columns, title=escape(shown(title)), title_justify="left")
        for row in rows:
            table.add_row(*(escape(shown(cell)) for cell in row))
        Console().print(table)
        return
    rows = [[shown(cell) for cell in row] for row in rows]
    widths = [max(len(line[i]) for line in (columns, *rows)) for i in range(len(columns))]
    write_line(title)
    for line in (columns, *rows):
        write_line(
            ("  " + "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True))).rstrip()
        )


def map_lines(density: Mapping[str, Any], encoding: str | None) -> list[str]:
    """Return the lines of a small map of shades, north up, with a legend.

    Parameters
    ----------
    density : mapping
        Density map made by `tiler.apps.clouds.density_map`.
    encoding : str or None
        Encoding of the terminal. If it has no block characters, the shades are ASCII characters.
    """
    rows = density["per_m2"]
    densities = sorted(value for row in rows for value in row if value > 0)
    if not densities:
        return []
    try:
        "░▒▓█".encode(encoding or "ascii")
        shades = "░▒▓█"
    except (UnicodeEncodeError, LookupError):
        shades = ".:*#"
    middle = densities[len(densities) // 2]
    limits = [share * middle for share in SHARES]
    legend = ", ".join(
        f"{shade} below {limit:.2g}" for shade, limit in zip(shades, limits, strict=False)
    )
    lines = [
        "".join(" " if v <= 0 else shades[bisect(limits, v)] for v in row).rstrip()
        for row in rows
    ]
    return [
        f"density map: points per m2, {legend}, {shades[-1]} more; a character is {density['width_m']:.3g} x "
        f"{density['height_m']:.3g} m, north is up",
        *(f"  {line}" for line in lines),
    ]


def print_facts(facts: Mapping[str, Any]) -> None:
    """Print one line per fact with aligned names and nested facts below, but skip facts that are None."""
    write_lines(fact_lines(facts))


def fact_lines(facts: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return the lines of `print_facts`, with spaces in the names of tiler.

    The names of files and tags do not change.
    """
    tiler_names = (n for n in facts if n.islower() and not set(n) & set("./-"))
    words = {name: name.replace("_", " ") for name in tiler_names}
    shown = {words.get(name, name): value for name, value in facts.items() if value is not None}
    width = max((len(name) for name in shown), default=0)
    lines = []
    for name, value in shown.items():
        if isinstance(value, Mapping):
            lines.append(f"{indent}{name}")
            lines.extend(fact_lines({str(k): v for k, v in value.items()}, indent + "  "))
        else:
            lines.append(f"{indent}{name.ljust(width)}  {_fact_text(value)}")
    return lines


def _fact_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, list | tuple):
        separator = "; " if any(isinstance(v, str) for v in value) else ", "
        return separator.join(_fact_text(v) for v in value) or "none"
    return str(value)


NAMES = ("stdout", "stderr")


@contextmanager
def open_streams(own_process: bool) -> Iterator[None]:
    """Let a command continue if the reader of its output has gone, but raise if results cannot be written.

    A run that is piped to ``head`` or ``true`` continues to its end. A full disk is an error
    for the results on stdout, but not for the progress on stderr.

    Parameters
    ----------
    own_process : bool
        Whether the process runs only this command. Then its streams stay replaced, because Python writes to them when
        it exits.
    """
    previous_streams = {name: getattr(sys, name) for name in NAMES}
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for name, stream in previous_streams.items():
            if stream is None:  # closed by the program that started the process
                setattr(sys, name, nowhere)
            elif own_process:
                setattr(sys, name, _patient(stream, name))
        try:
            yield
        finally:
            for name, stream in previous_streams.items():
                if stream is None or not own_process:
                    setattr(sys, name, stream)


def _patient(stream: TextIO, name: str) -> TextIO:
    """Return a text stream like ``stream`` that writes through a `_Patient`."""
    try:
        raw = _Patient(stream.fileno(), name)
    except OSError:  # the caller replaced the stream by an object without a descriptor
        return stream
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, stream.encoding, stream.errors, line_buffering=bool(stream.line_buffering)
    )


class _Patient(io.FileIO):
    """Standard stream that drops output after an error. It raises the error only on stdout with a reader."""

    def __init__(self, descriptor: int, called: str) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._called = called
        self._lost = False

    def write(self, data: Any) -> int:
        """Write the data, or drop them after the first failure."""
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                # Windows has no own error for a reader that has gone.
                gone = isinstance(error, BrokenPipeError) or (
                    os.name == "nt" and error.errno == errno.EINVAL
                )
                if not gone and self._called == "stdout":
                    raise write_error(self._called, error) from error
        return memoryview(data).nbytes
