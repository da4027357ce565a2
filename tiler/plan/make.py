"""Making the plan: the headers read, everything settled that can be settled from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from ptd.methods import METHODS, make_params
from ptd.params import to_json
from ptd.passes import Pass
from tiler import advice
from tiler.config import RunConfig
from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.errors import ConfigError, InputError
from tiler.ingest import SourceInfo, agree, find_inputs, inspect, inspect_guarded
from tiler.places import cloud_path, is_url
from tiler.plan import sizes
from tiler.plan.area import area_of, part_of
from tiler.plan.crowd import Crowd
from tiler.plan.memory import FINE_CELL_M, PlannedPass
from tiler.plan.model import KEEP, Plan
from tiler.plan.refuse import refuse, warnings_of
from tiler.report import earlier_statistics
from tiler.schedule import Guards
from tiler.store import StoreMeta

FILES_OF_A_READER = 16
"""Inputs for which one more process is started: it takes as long to start as to look into so many."""
FAR_READERS = 8
"""Processes that look into objects at URLs: they wait for answers most of the time, whatever the number of cores."""


def make_plan(inputs: Sequence[str], config: RunConfig, out: Path | None = None) -> Plan:
    """Read the headers, settle CRS, units, method, sizes, and refuse what cannot work.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs.
    config : RunConfig
    out : Path, optional
        The run's folder: not searched for inputs, and its disk is checked.

    Raises
    ------
    ConfigError
        Settings that cannot work: method, parameters, memory, disk.
    InputError
        No readable input, or a CRS that cannot be used.
    """
    parameters, defaults = _method(config)
    notes: list[str] = []
    paths = find_inputs(inputs, () if out is None else (out,), notes.append)
    sources, unreadable = _inspect_all(paths, config)
    agreement = agree(sources, config)
    notes += agreement.notes
    filled = [s for s in sources if s.points and s.bounds is not None]
    notes += [f"{s.path}: {text}" for s in sources for text in s.notes]
    if not filled:
        raise InputError(f"{_names(sources)}: hold no point; nothing to make a terrain of")
    area = area_of(config, agreement.wkt, notes)
    metres = float(agreement.units.horizontal)
