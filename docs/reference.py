"""Write ``docs/parameters.md`` from the dataclasses: ``python docs/reference.py``. A test compares them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from cli.commands.methods import parameter_facts, range_text  # noqa: E402
from cli.options import SETTINGS, default_text  # noqa: E402
from ptd.methods import METHODS  # noqa: E402
from tiler.config.sources import preset_names, preset_text  # noqa: E402

TARGET = HERE / "parameters.md"

HEAD = """# Parameters

`python docs/reference.py` makes this page from the source; change the source, not the page.

The value of a setting comes from these sources, each overriding the ones before it: the default, `--preset NAME`,
`--config FILE.toml`, the command line. In a file, a setting has the name below with `_` for `-` and without the leading
dashes. Lengths are in metres unless written with a unit (`3ft`, `50cm`). `tiler config` prints the effective values,
`tiler config --template` a commented file to start from.
"""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)
        + "\n"
    )


def _cell(text: str) -> str:
    """Escape text for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("<", "&lt;")


def settings() -> str:
    """Return the table of the settings of a run."""
    rows = []
    for spec in SETTINGS.values():
        name = "set" if spec.metadata["kind"] == "pairs" else spec.name.replace("_", "-")
        default = default_text(spec).replace("_", "\\_")  # Underscores would start italics.
        rows.append((f"`--{name}`", default, spec.metadata["unit"], spec.metadata["help"]))
    return table(("option", "default", "unit", "meaning"), rows)


def presets() -> str:
    """Return the content of the files of the presets."""
    parts = []
    for name in preset_names():
        text = preset_text(name)
        first, _, rest = text.partition("\n")
        parts.append(
            f"### `{name}`\n\n{first.removeprefix('# ')}\n\n```toml\n{rest.strip()}\n```\n"
        )
    return "\n".join(parts)


def methods() -> str:
    """Return the tables of the parameters of each method."""
    parts = []
    for name, method in METHODS.items():
        rows = []
        for fact in parameter_facts(method.params):
            value = fact["default"]
            default = ("no", "yes")[value] if isinstance(value, bool) else str(value)
            span = range_text(fact["minimum"], fact["maximum"])
            rows.append(
                (f"`{fact['name']}`", default, fact["unit"], span, fact["help"], fact["source"])
            )
        head = ("parameter", "default", "unit", "range", "meaning", "source")
        parts.append(
            f"### `{name}`\n\n{method.summary[:1].upper()}{method.summary[1:]}.\n\n{table(head, rows)}"
        )
    return "\n".join(parts)


def page() -> str:
    """Return the whole document."""
    return "\n".join(
        (
            HEAD,
            "## Settings of a run\n",
            settings(),
            "## Presets\n",
            presets(),
            "## Methods and their parameters\n",
            "`--method NAME`, `--set parameter=value` (the unit at the end of a name can be left out). `--method keep` "
            "filters nothing: it grids the classes of the input.\n",
            methods(),
        )
    )


if __name__ == "__main__":
    TARGET.write_text(page(), "utf-8")
