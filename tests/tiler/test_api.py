"""The Python interface: its examples, its results in notebooks, and calls from where no file is the main program."""

from __future__ import annotations

import asyncio
import dataclasses
import doctest
import logging
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS

import ptd.api
import tiler.api
from tests.integration.command import environment

SIDE = 43
PLAIN = {"method": "classic", "resolution": 2, "workers": 1, "water": "none"}
USES_OLD_AFFINE = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
"""rioxarray for Python 3.11 multiplies transforms as affine 2 did."""
EXAMPLES = [
    test
    for module in (tiler.api, ptd.api)
    for test in doctest.DocTestFinder().find(module)
    if test.examples
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the examples find it: a tilted plane, 1 point/m2, with a tree; and checkpoints on it."""
    made = tmp_path_factory.mktemp("examples")
    (made / "clouds").mkdir()
    x, y = (v.ravel() for v in np.mgrid[0:SIDE, 0:SIDE].astype(float))
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.header.add_crs(CRS.from_epsg(25832))
    cloud.header.offsets = np.array([500_000.0, 5_400_000.0, 0.0])
    cloud.header.scales = np.full(3, 0.001)
    cloud.x, cloud.y = 500_000 + x, 5_400_000 + y
    cloud.z = 0.1 * x + 8.0 * (np.hypot(x - 20, y - 20) < 2)
    cloud.write(str(made / "clouds/a.las"))
    rows = [f"{500_000 + x},{5_400_000 + 7.5},{0.1 * x},NVA" for x in (5.5, 8.5, 30.5)]
    (made / "checkpoints.csv").write_text("\n".join(["x,y,z,type", *rows]))
    return made


@pytest.fixture(autouse=True)
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """No processes beside this one: they take seconds to start."""
    read = tiler.api._settings
    monkeypatch.setattr(
        "tiler.api._settings", lambda *given: read(*given).updated(in_process=True)
    )
    monkeypatch.setattr(
        "tiler.apps.check.measuring.call_isolated",
        lambda function, *arguments, **limits: function(*arguments),
    )


def test_everything_offered_has_an_example() -> None:
    assert {test.name for test in EXAMPLES} == {
        *(
            f"tiler.api.{name}"
            for name in ("run", "classify", "check", "check_clouds", "open_store")
        ),
        "ptd.api.classify",
    }


@pytest.mark.parametrize(
    "order", [["run", "check", "check_clouds", "open_store"], ["api.classify"]], ids=",".join
)
def test_examples(order: list[str], in_process: None) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for name in order:
        for test in EXAMPLES:
            if test.name.endswith(f".{name}"):
                runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


def test_the_package_offers_what_its_api_has() -> None:
    assert set(tiler.api.__all__) == set(tiler.__all__) - {"__version__"}
    assert set(tiler.__all__) <= set(dir(tiler))
    for name in tiler.__all__:
        assert getattr(tiler, name) is not None


def imported(code: str) -> set[str]:
    made = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"],
        capture_output=True, text=True, check=True, env=environment(),
    )  # fmt: skip
    return set(made.stdout.split())


@pytest.mark.processes
def test_importing_the_packages_is_cheap() -> None:
    loaded = imported("import tiler, ptd")
    assert not loaded & {"numpy", "numba", "dask", "zarr", "rasterio", "tiler.api", "ptd.api"}
    assert "numba" not in imported(
        "import ptd.arrays, tiler.inputs.sources; from ptd import Evidence"
    )


class Markup(HTMLParser):
    """Tags of a piece of HTML, and where its links lead."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.links: list[str | None] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links += [value for name, value in attrs if name == "href"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows allows no such names")
def test_a_run_tells_and_shows(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, in_process: None
) -> None:
    told: list[tiler.Progress] = []
    Path("<i>&").mkdir()
    shutil.copy("clouds/a.las", "<i>&/<script>.las")
    with caplog.at_level(logging.INFO, "tiler"):
        result = tiler.run(Path("<i>&"), "<b>out", PLAIN, progress=told.append)
    assert capfd.readouterr().out == ""
    assert told[-1]["message"] == "done"
    messages = [record.getMessage() for record in caplog.records if record.name == "tiler"]
    assert messages == [t["message"] for t in told if t["message"]] == [*result.notes, "done"]
    by = {decision.setting: decision.by for decision in result.decisions}
    assert (by["resolution"], by["halo"]) == ("you", "automatic")
    assert "summary" not in repr(result)
    assert all(Path(path).exists() for path in result.files.values())
    shown = Markup(result._repr_html_())
    assert shown.tags == {
        "div",
        "b",
        "p",
        "img",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "ul",
        "li",
        "a",
    }
    assert shown.links
    assert all(link is not None and Path(unquote(link)).exists() for link in shown.links)
    assert "<b>out" not in result._repr_html_()


def test_settings_are_keywords_too() -> None:
    read = tiler.api._settings
    mixed = read({"method": "classic"}, {"resolution": 0.5, "crs": 2154})
    assert mixed == tiler.api.RunConfig.from_mapping(
        {"method": "classic", "resolution": "0.5", "crs": "EPSG:2154"}
    )
    assert read(mixed, {"resolution": "2"}) == mixed.updated(resolution=2)


@USES_OLD_AFFINE
def test_the_terrain_as_an_array(in_process: None) -> None:
    pytest.importorskip("rioxarray")
    result = tiler.api.run("clouds", "array", PLAIN)
    with rasterio.open(result.files["dtm.tif"]) as raster:
        band = raster.read(1, masked=True).filled(np.nan)
        bounds = raster.bounds
    array = result.dtm()
    assert array.dims == ("y", "x")
    assert array.dtype == np.float32
    np.testing.assert_array_equal(array.values, band)
    assert array.rio.crs.to_epsg() == 25832
    assert array.rio.bounds() == pytest.approx(tuple(bounds))


@USES_OLD_AFFINE
def test_the_terrain_of_sheets_is_one_array(in_process: None) -> None:
    pytest.importorskip("rioxarray")
    whole = tiler.api.run("clouds", "array", PLAIN).dtm()
    cut = tiler.api.run("clouds", "cut", PLAIN, sheets=20).dtm()
    np.testing.assert_array_equal(cut.sel(x=whole.x, y=whole.y).values, whole.values)


def test_no_terrain_no_array(in_process: None) -> None:
    pytest.importorskip("rioxarray")
    result = tiler.api.run("clouds", "steep", PLAIN, products="slope")
    with pytest.raises(tiler.api.ConfigError, match="has no terrain; run with the product dtm"):
        result.dtm()


def test_without_rioxarray_the_remedy_is_named(
    in_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiler.api.run("clouds", "array", PLAIN)
    monkeypatch.setitem(sys.modules, "rioxarray", None)
    with pytest.raises(tiler.api.ConfigError, match="pip install"):
        result.dtm()


def test_true_shows_progress_on_stderr(
    in_process: None, capsys: pytest.CaptureFixture[str]
) -> None:
    tiler.api.run("clouds", "seen", PLAIN, progress=True)
    assert "no vertical CRS" in capsys.readouterr().err
    tiler.api.run("clouds", "unseen", PLAIN)
    assert capsys.readouterr().err == ""


def test_an_open_store_says_what_it_holds(in_process: None) -> None:
    tiler.api.run("clouds", "held", PLAIN, until="ingest")
    text = repr(tiler.api.open_store("held/store.zarr"))
    assert f"{SIDE * SIDE:,} points in 1 buckets, ETRS89 / UTM zone 32N" in text
    shutil.rmtree("held/store.zarr")


def test_a_classified_cloud_and_a_check_show(in_process: None) -> None:
    classified = tiler.classify("clouds/a.las", "shown.laz", PLAIN)
    cell = rf'<td class="number"[^>]*>{classified.classes[2]:,}</td>'
    assert re.search(cell, classified._repr_html_())
    assert Markup(classified._repr_html_()).links == ["shown.laz"]
    named = dataclasses.replace(classified, path=Path("javascript:alert(1)%.laz"))
    assert Markup(named._repr_html_()).links == ["javascript%3Aalert%281%29%25.laz"]
    tiler.run("clouds", "checked", PLAIN)
    checked = tiler.check(
        "checked/dtm.tif", "checkpoints.csv", require=["rmse=0.1", "points=4"], tile_size=20
    )
    assert (checked.met, checked.exit_code) == (False, 5)
    assert len(re.findall("<td[^>]*>NO</td>", checked._repr_html_())) == 1


def test_a_filter_shows_what_it_decided() -> None:
    x, y = (v.ravel() for v in np.mgrid[0:20, 0:20].astype(float))
    result = ptd.classify(np.stack([x, y, 0.1 * x], axis=1), "classic")
    shown = Markup(result._repr_html_())
    assert "table" in shown.tags
    assert "ground" in result._repr_html_()


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: tiler.run("none.laz", "o"), "none.laz: no such file"),
        (
            lambda: tiler.run("clouds", "o", {"resolution": "far"}),
            "resolution: 'far' is not a length",
        ),
        (lambda: tiler.run("clouds", "o", {"resolutoin": 1}), "unknown setting 'resolutoin'"),
        (lambda: tiler.classify("none.laz", "b.laz"), "none.laz: no such file"),
        (lambda: tiler.check("none.tif", "checkpoints.csv"), "none.tif: cannot be read"),
        (lambda: tiler.open_store("none"), "none: no tile store here"),
        (
            lambda: tiler.run(b"clouds", "o"),
            "inputs: b'clouds' is bytes, not a path; give a str or a pathlib.Path",
        ),
        (lambda: tiler.run(None, "o"), "inputs: None is NoneType, not a path"),
        (lambda: tiler.run(["clouds", 7], "o"), "inputs: 7 is int, not a path"),
        (lambda: tiler.run("a\0.laz", "o"), "inputs: 'a\\x00.laz' contains a NUL character"),
        (lambda: tiler.run("clouds", None), "out: None is NoneType, not a path"),
        (lambda: tiler.run("clouds", b"o"), "out: b'o' is bytes, not a path"),
        (
            lambda: tiler.run("clouds", "o\0"),
            "out: 'o\\x00' contains a NUL character; give a path without it",
        ),
        (
            lambda: tiler.run("clouds", "o", 5),
            "config: 5 is int, not a mapping; give a dict of settings",
        ),
        (
            lambda: tiler.run("clouds", "o", {"store": "a\0"}),
            "store 'a\\x00': holds a NUL character",
        ),
        (lambda: tiler.classify(None, "b.laz"), "source: None is NoneType"),
        (lambda: tiler.classify("none.laz", "b\0.laz"), "target: 'b\\x00.laz' contains a NUL"),
        (lambda: tiler.check("none.tif", b"points.csv"), "points: b'points.csv' is bytes"),
        (lambda: tiler.open_store(None), "path: None is NoneType"),
    ],
)
def test_what_is_refused_is_one_line(
    call: Callable[[], object], line: str, in_process: None
) -> None:
    with pytest.raises(tiler.TilerError) as refused:
        call()
    assert str(refused.value).startswith(line)
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code in (2, 3)


CONFIGURATION = """
import copy, logging, sys
import dask, distributed, numcodecs.blosc, numpy, zarr

def configuration():
    levels = [logging.getLogger(name).level for name in (None, "distributed", "distributed.client")]
    found = dask.config.config, zarr.config.config, sys.path, levels, numpy.geterr(), numcodecs.blosc.use_threads
    return copy.deepcopy(found)

before = configuration()
import tiler
result = tiler.run("clouds", "configured", {"method": "classic", "resolution": 2, "workers": 1})
assert result.exit_code == 0
assert configuration() == before
"""


@pytest.mark.processes
def test_a_run_leaves_the_configuration_of_libraries_as_it_was() -> None:
    made = subprocess.run(
        [sys.executable, "-c", CONFIGURATION],
        capture_output=True,
        text=True,
        check=False,
        env=environment(),
    )
    assert (made.returncode, made.stderr) == (0, "")


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize("how", ["script.py", "-c", "-"])
def test_the_main_program_needs_no_guard(how: str, folder: Path) -> None:
    """Workers do not import it again, and there may be no file of it."""
    code = f"import tiler\nprint(tiler.run('clouds/', 'out{how}', {PLAIN}).exit_code)\n"
    (folder / "script.py").write_text(code)
    made = subprocess.run(
        [sys.executable, how, *([code] if how == "-c" else [])],
        input=code, capture_output=True, text=True, check=False, env=environment(),
    )  # fmt: skip
    assert (made.returncode, made.stdout, made.stderr) == (0, "0\n", "")


@pytest.mark.slow
def test_a_run_within_an_event_loop() -> None:
    """As in a notebook, whose cells run in one."""

    async def cell() -> int:
        return tiler.run("clouds/", "loop", PLAIN).exit_code

    assert asyncio.run(cell()) == 0
