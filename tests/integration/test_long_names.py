"""Names of inputs as long as a disk allows: what becomes of them is written, or refused in the plan."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.invariants import clouds
from tests.invariants.runs import do, settings
from tiler.errors import ConfigError
from tiler.plan import make_plan

pytestmark = pytest.mark.skipif(
    os.name == "nt", reason="Windows opens longer paths only with a setting"
)
HOW = {"water": "none", "products": "dtm", "sheets": "20"}


def cloud(folder: Path, size: int, suffix: str) -> Path:
    """A cloud whose name has so many bytes."""
    name = "n" * (size - len(suffix)) + suffix
    small = clouds.write(folder / f"small{suffix}", clouds.city(20.0, 4.0))
    os.replace(small, folder / name)
    return folder / name


@pytest.mark.parametrize(
    ("size", "suffix", "classified"),
    [
        (255, ".laz", "laz"),
        (255, ".las", "laz"),
        (255, ".laz", "las"),
        (250, ".laz", "copc"),
        (255, ".las", "none"),
    ],
)
def test_the_longest_names_are_written(
    size: int, suffix: str, classified: str, tmp_path: Path
) -> None:
    path = cloud(tmp_path, size, suffix)
    assert do(path, tmp_path / "out", classified=classified, **HOW).exit_code == 0
    made = [file.name for file in (tmp_path / "out/classified").glob("*")]
    ending = {"laz": ".laz", "las": ".las", "copc": ".copc.laz"}.get(classified)
    assert made == ([] if ending is None else [path.name.removesuffix(suffix) + ending])
    assert not list((tmp_path / "out").rglob("*.partial"))


@pytest.mark.parametrize("size", [251, 255])
def test_longer_ones_are_refused_in_the_plan(size: int, tmp_path: Path) -> None:
    path = cloud(tmp_path, size, ".laz")
    told = rf"its classified cloud n+\.\.\.\.laz would have a name of {size + 5} bytes, but at most 255 are possible; "
    with pytest.raises(
        ConfigError,
        match=told + "rename the input, use --classified laz, or use --classified none",
    ):
        make_plan([str(path)], settings(classified="copc", **HOW))
    with pytest.raises(ConfigError, match=told):
        do(path, tmp_path / "out", classified="copc", **HOW)
    for how in (
        {"out": tmp_path / ("o" * 256)},
        {"out": tmp_path / "out", "store": str(tmp_path / ("o" * 256) / "s")},
    ):
        with pytest.raises(
            ConfigError, match=r"^-(o|-store) o{20}\.\.\.: its name has 256 bytes"
        ):
            do(path, **how, **HOW)
    assert not (tmp_path / "out").exists()
