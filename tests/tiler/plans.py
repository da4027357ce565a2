"""Plans with other values."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from tiler.plan import Plan

PARTS = ("inputs", "grid", "method", "resources")


def changed(plan: Plan, **values: Any) -> Plan:
    """Return a plan with other values of fields of its parts, such as `points` or `tile`."""
    for name in PARTS:
        part = getattr(plan, name)
        names = {field.name for field in fields(part)} & values.keys()
        part = replace(part, **{field: values.pop(field) for field in names})
        plan = replace(plan, **{name: part})
    assert not values
    return plan
