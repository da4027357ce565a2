"""Progress in a Jupyter notebook: one bar that is updated in place, with the warnings below it."""

from __future__ import annotations

import html
import sys
from typing import Any

from tiler.observe.json_lines import Progress
from tiler.observe.progress import duration_text
from tiler.redaction import shown


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook, without importing IPython."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    return type(get_ipython()).__name__ == "ZMQInteractiveShell"


class NotebookBar:
    """Bar for progress records (`tiler.observe.json_lines.ProgressRecords`) in the output of a notebook's cell."""

    def __init__(self) -> None:
        from IPython import display

        jupyter: Any = display  # The functions of IPython have no types.
        self._html = jupyter.HTML
        self._warnings: list[str] = []
        self._shown = jupyter.display(self._html(""), display_id=True)

    def __call__(self, progress: Progress) -> None:
        """Update the bar with new progress."""
        if progress["level"] == "warning" and progress["message"]:
            self._warnings.append(progress["message"])
        self._shown.update(self._html(bar_markup(progress, self._warnings)))


def bar_markup(progress: Progress, warnings: list[str]) -> str:
    """Return the HTML of a bar, of the running stage with the time left, and of warnings.

    Parameters
    ----------
    progress : Progress
    warnings : list of str
        All warnings of the job so far.
    """
    done = progress["progress"]
    parts = []
    if done is not None:
        parts.append(f"{done:.0%}")
    if progress["title"]:
        parts.append(progress["title"])
    if progress["eta"] is not None:
        parts.append(f"about {duration_text(progress['eta'])} left")
    if progress["message"] == "done":
        done, parts = 1.0, ["done"]
    bar = "<progress></progress>"
    if done is not None:
        bar = f'<progress value="{done:.4f}" max="1"></progress>'
    lines = [f"{bar} {_text(', '.join(parts))}"]
    lines += [f"warning: {_text(warning)}" for warning in warnings]
    return "".join(f"<div>{line}</div>" for line in lines)


def _text(text: str) -> str:
    return html.escape(shown(text))
