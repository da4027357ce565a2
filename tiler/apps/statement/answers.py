"""Answers of an operator to the drawn squares, which the page saves as JSON."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from tiler.errors import InputError
from tiler.io.foreign_content import excerpt, parse_json_object

SHARES = {
    "none": 0.0,
    "up to a quarter": 0.25,
    "up to half": 0.5,
    "up to three quarters": 0.75,
    "more, or not sure": 1.0,
}
"""Answers to what share of an outlined area is an object. They are rounded up, so that a bound stays true."""
MAX_DRAWS = 100_000
MAX_BYTES = 4 << 20
"""Largest size of a file of answers. That of `MAX_DRAWS` has less than 2 MB."""
REMEDY = "give the file of answers that the page saved"
_DRAW = re.compile("[1-9][0-9]{0,5}")


def read_answers(path: Path) -> tuple[str, dict[int, float]]:
    """Return the key of the sample that was answered, and the answers by draw, or raise InputError."""
    if not path.is_file():
        raise InputError(f"{path}: is no file; {REMEDY}")
    try:
        with path.open("rb") as stream:
            text = stream.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise InputError(f"{path}: has more than {MAX_BYTES >> 20} MiB; {REMEDY}")
        content = parse_json_object(text.decode("utf-8-sig"), distinct_keys=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {REMEDY}") from error
    except ValueError as error:
        raise InputError(f"{path}: is not a file of answers ({error}); {REMEDY}") from error
    key, answers = content.get("sample"), content.get("answers")
    if not isinstance(key, str) or not isinstance(answers, Mapping):
        raise InputError(f"{path}: is not a file of answers; {REMEDY}")
    for draw, share in answers.items():
        if not _DRAW.fullmatch(draw) or int(draw) > MAX_DRAWS:
            raise InputError(f"{path}: {excerpt(draw)} is not a number of a draw; {REMEDY}")
        if isinstance(share, bool) or share not in SHARES.values():
            raise InputError(
                f"{path}: draw {draw}: {excerpt(share)} is not an answer; {REMEDY}"
            )
    return key, {int(draw): float(share) for draw, share in answers.items()}
