"""A notebook that is written, executed and read: progress, the result, and the terrain as an array."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.integration.command import environment
from tests.waiting import PATIENCE_SECONDS

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")
pytest.importorskip("rioxarray")

CELLS = [
    "import tiler",
    "result = tiler.run('hill.laz', 'out', resolution=2, method='classic', workers=1)",
    "result",
    "array = result.dtm()\nprint(array.dims, float(array.max()) > float(array.min()))",
    "quiet = tiler.run('hill.laz', 'out', resolution=2, method='classic', workers=1, progress=False)",
]


def executed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[list[dict[str, Any]]]:
    """The outputs of each cell of the notebook, which is executed in a folder."""
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS]
    )
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    client = nbclient.NotebookClient(
        notebook,
        timeout=PATIENCE_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return [cell.outputs for cell in notebook.cells]


@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning", "default::ResourceWarning")
def test_a_notebook_shows_progress_and_results(
    cloud: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, run, result, array, quiet = executed(cloud.parent, monkeypatch)
    (bar,) = [output["data"]["text/html"] for output in run]
    assert '<progress value="1.0000" max="1"></progress> done' in bar
    assert "tiler.run: finished" in result[0]["data"]["text/html"]
    assert array[0]["text"] == "('y', 'x') True\n"
    assert quiet == []
