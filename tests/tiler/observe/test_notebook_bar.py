"""The bar of a notebook: its content, and that no text of a file becomes markup."""

from __future__ import annotations

from tiler.observe.json_lines import progress_record
from tiler.observe.progress import bar_markup, in_notebook


def test_the_bar_shows_the_progress_of_the_job() -> None:
    record = progress_record() | {"progress": 0.25, "title": "terrain", "eta": 90.0}
    assert bar_markup(record, []) == (
        '<div><progress value="0.2500" max="1"></progress> 25%, terrain, about 1:30 min left</div>'
    )


def test_the_bar_is_full_at_the_end() -> None:
    assert bar_markup(progress_record("done"), []) == (
        '<div><progress value="1.0000" max="1"></progress> done</div>'
    )


def test_the_bar_has_no_value_before_the_stages_are_known() -> None:
    assert bar_markup(progress_record(), []) == "<div><progress></progress> </div>"


def test_names_of_files_are_no_markup() -> None:
    shown = bar_markup(progress_record(), ["<img src=x>.laz: left out"])
    assert "<img" not in shown
    assert "warning: &lt;img src=x&gt;.laz: left out" in shown


def test_a_script_is_no_notebook() -> None:
    assert not in_notebook()
