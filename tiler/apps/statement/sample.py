"""Sample of squares: the draws that count, the bound that follows from the answers, and the next squares.

The answers of an operator to the drawn squares are a JSON file, which the page saves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tiler.apps.statement.squares import Squares
from tiler.core.betting import upper_bound
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


@dataclass(frozen=True)
class Sample:
    """Knowledge of the objects in the rising terrain of some squares.

    Attributes
    ----------
    shares : tuple of float
        Answers to the draws before the first one without an answer, in their order.
    waiting : int
        Number of later draws with an answer. A sample with gaps would not be random.
    todo : mapping of int to int
        First draw of each of the next squares without an answer, by index of the square.
    seen, squares : int
        Numbers of squares with an answer and of all squares.
    max_pixels : float
        Upper bound of the number of rising pixels that are objects.
    """

    shares: tuple[float, ...]
    waiting: int
    todo: Mapping[int, int]
    seen: int
    squares: int
    max_pixels: float


def sample_of(
    squares: Squares, key: str, answers: Mapping[int, float], max_squares: int
) -> Sample:
    """Return the sample with some answers by draw, and at most ``max_squares`` squares to look at next.

    Parameters
    ----------
    squares : Squares
        At least one square.
    key : str
        Key of the draws.
    answers : mapping of int to float
        Share of a draw's square that is an object.
    max_squares : int
    """
    shares_of: dict[int, float] = {}
    for draw, share in answers.items():
        index = squares.drawn(key, draw)
        # One answer is for all draws of a square. Of several, the largest keeps the bound true.
        shares_of[index] = max(share, shares_of.get(index, 0.0))
    last = max(answers, default=0)
    counting: list[float] = []
    todo: dict[int, int] = {}
    unseen = squares.rising.size - len(shares_of)
    for draw in range(1, MAX_DRAWS + 1):
        if len(todo) == min(max_squares, unseen) and (todo or draw > last):
            break
        index = squares.drawn(key, draw)
        if index not in shares_of:
            todo.setdefault(index, draw)
        elif not todo:
            counting.append(shares_of[index])
    waiting = sum(draw > len(counting) for draw in answers)
    rising = squares.rising.tolist()
    # All that the answers leave open may be objects, and no more. What was found is the least.
    found = sum(share * rising[i] for i, share in shares_of.items())
    certain = found + squares.all_rising - sum(rising[i] for i in shares_of)
    bound = certain
    if unseen:
        bound = min(max(upper_bound(counting) * squares.all_rising, found), certain)
    return Sample(tuple(counting), waiting, todo, len(shares_of), len(rising), bound)


def draws_needed(share: float) -> int:
    """Return the number of draws without an object after which the bound of the share of objects is small enough."""
    low, high = 0, 1
    while upper_bound(high * [0.0]) > share:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if upper_bound(middle * [0.0]) > share else (low, middle)
    return high


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
