"""Whole commands on folders of every kind: no file that was there before is lost or changed, unless it is a result."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from tests.integration.trees import STEPS, TREES, planted, put, tried

FEW, MANY = 20, 90

pytestmark = pytest.mark.usefixtures("in_this_process")


def look(things: list[Any], steps: list[Any]) -> None:
    """Do the steps one after another, and look at all files after each command."""
    with planted(things) as tree:
        for kind, what in steps:
            if kind == "put":
                put(tree, what)
            else:
                tried(tree, what)


HOW = {
    "deadline": None,
    "database": None,
    "suppress_health_check": list(HealthCheck),
    "print_blob": False,
}


@seed(11)
@settings(max_examples=FEW, **HOW)
@given(TREES, STEPS)
def test_commands_leave_files_of_others_alone(things: list[Any], steps: list[Any]) -> None:
    look(things, steps)


@pytest.mark.slow
@settings(max_examples=MANY, **HOW)
@given(TREES, STEPS, st.just(None))
def test_commands_leave_files_of_others_alone_in_many_trees(
    things: list[Any], steps: list[Any], again: None
) -> None:
    look(things, steps)
