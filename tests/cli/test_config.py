"""Settings: defaults, then the file, then the options; and the files that `tiler config` prints."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.commands.config import toml_line
from cli.main import main
from tiler.config import RunConfig


@pytest.fixture
def effective(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call ``tiler plan`` with options; the settings that reach the library."""
    seen: list[RunConfig] = []

    monkeypatch.setattr(
        "tiler.apps.resolutions.make_plan", lambda inputs, config, out: seen.append(config)
    )
    monkeypatch.setattr("tiler.plan.plan_lines", lambda plan: [])

    def call(*options: str) -> RunConfig:
        assert main(["plan", "a.laz", *options]) == 0
        return seen.pop()

    return call


def test_nothing_given_is_the_defaults(effective: Any) -> None:
    assert effective() == RunConfig()


def test_every_kind_of_option(effective: Any) -> None:
    config = effective(
        "--resolution", "3ft", "--halo", "0", "--memory", "2GiB", "--workers", "3", "--keep-classes", "18,7",
        "--bounds", "-10", "0", "1.5", "2e3", "--salvage", "--crs", "none", "--units", "ft,m", "--compress", "zstd",
        "--set", "rounds=3", "--set", "label_pass=no", "--store", "s3://bucket/key", "--aoi", "parcel.gpkg",
    )  # fmt: skip
    assert config == RunConfig(
        resolution=Fraction(9144, 10000),
        halo=Fraction(0),
        memory=2 << 30,
        workers=3,
        keep_classes=(7, 18),
        bounds=(-10.0, 0.0, 1.5, 2000.0),
        salvage=True,
        crs="none",
        units="ft,m",
        compress="zstd",
        parameters=(("rounds", "3"), ("label_pass", "no")),
        store="s3://bucket/key",
        aoi="parcel.gpkg",
    )


def test_products_come_in_their_order(effective: Any) -> None:
    assert effective("--products", "slope, dtm").products == ("dtm", "slope")
    assert effective("--surface", "p10", "--erode", "0").surface_percent == 10
    assert [effective("--surface", name).surface_percent for name in ("all", "median")] == [
        None,
        50,
    ]


def test_no_class_at_all_can_be_said(effective: Any) -> None:
    assert effective("--keep-classes", "").keep_classes == ()


def test_options_win_over_the_file(effective: Any, tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(
        'resolution = 0.5\nmemory = "4GB"\nsalvage = true\nworkers = 2\n[parameters]\nrounds = 5\nlow_group = 7\n'
    )
    config = effective("--config", str(file))
    assert (config.resolution, config.memory, config.salvage) == (
        Fraction(1, 2),
        4 * 10**9,
        True,
    )
    assert config.workers == 2
    assert config.parameters == (("rounds", "5"), ("low_group", "7"))
    config = effective(
        "--config", str(file), "--resolution", "2", "--no-salvage", "--set", "rounds=1"
    )
    assert (config.resolution, config.memory, config.salvage) == (Fraction(2), 4 * 10**9, False)
    assert dict(config.parameters) == {"rounds": "1", "low_group": "7"}


@pytest.mark.parametrize(
    ("text", "error"),
    [("color = 1", "unknown setting 'color'"), ("resolution = ", "not valid TOML"), ("workers = 1.5", "workers 1.5"),
     ("salvage = 'yes'", "salvage 'yes'"), ("compress = 'zip'", "compress 'zip'"),
     ("products = 'dtm,dms'", "products 'dms'"), ("products = []", "products is empty"), ("products = 3", "products 3"),
     ("surface = 'p101'", "surface 'p101'"), ("surface = 'mean'", "surface 'mean'"), ("voids = 'mend'", "voids 'mend'"),
     ("interpolation = 'spline'", "interpolation 'spline'"), ("erode = '-1'", "erode: '-1'"),
     ("parameters = 3", "parameters 3"), ("parameters = [1]", "--set 1"), ("memory = -1", "memory: -1"),
     ("memory = true", "memory: True"), ("memory = [1]", "memory: [1]"),
     ("keep_classes = [1.5]", "keep_classes: [1.5]"), ("keep_classes = true", "keep_classes: True"),
     ("bounds = [-inf, 0, inf, 1]", "bounds"),
     ("bounds = [1e300, 0, 1e301, 1]", "bounds [1e+300"), ("method = 'm\udcff'", "byte 11 is not UTF-8")],
)  # fmt: skip
def test_a_bad_file_is_one_line(
    text: str, error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(text, "utf-8", "surrogateescape")
    assert main(["config", "--config", str(file)]) == 2
    captured = capsys.readouterr().err
    assert captured.startswith(f"tiler: error: {file}: ")
    assert error in captured
    assert captured.count("\n") == 1


def test_an_option_replaces_a_bad_setting_of_the_file(effective: Any, tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("workers = 1.5")
    assert effective("--config", str(file), "--workers", "2").workers == 2


def test_a_bad_option_does_not_name_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("workers = 2")
    assert main(["config", "--config", str(file), "--resolution", "wide"]) == 2
    assert str(file) not in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--help", "--help-all"])
def test_the_help_of_voids_names_the_models_that_it_fills(
    capsys: pytest.CaptureFixture[str], option: str
) -> None:
    main(["run", option])
    text = capsys.readouterr().out.split("--voids")[1].split("--canopy")[0]
    assert "DTM" in text
    assert "DSM" in text


def test_template_gives_the_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--template"]) == 0
    text = capsys.readouterr().out
    assert RunConfig.from_mapping(tomllib.loads(text)) == RunConfig()
    for name in RunConfig().to_json():
        assert name == "parameters" or f"\n{name} = " in text or f"\n# {name} =" in text


def test_effective_settings_come_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bounds = ("--bounds", "0", "0", "0.1", "7")
    assert (
        main(
            [
                "config",
                "--resolution",
                "1/3",
                "--set",
                "rounds=3",
                *bounds,
                "--crs",
                'say "ä"\\',
            ]
        )
        == 0
    )
    first = capsys.readouterr().out
    config = RunConfig.from_mapping(tomllib.loads(first))
    assert config.resolution == Fraction(1, 3)
    assert config.bounds == (0.0, 0.0, 0.1, 7.0)
    assert config.crs == 'say "ä"\\'
    assert dict(config.parameters)["rounds"] == "3"
    (tmp_path / "settings.toml").write_text(first, "utf-8")
    assert main(["config", "--config", str(tmp_path / "settings.toml")]) == 0
    assert capsys.readouterr().out == first


def test_keep_has_no_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--method", "keep"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("[parameters]")


plain = st.text() | st.booleans() | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False)


@given(plain | st.lists(plain, max_size=4))
def test_any_plain_value_is_a_line_that_toml_reads_back(value: Any) -> None:
    line = toml_line("name", value)
    assert "\n" not in line
    assert tomllib.loads(line)["name"] == value


def test_a_file_of_windows_is_read(effective: Any, tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_bytes(
        "resolution = 2\r\nmemory = 2000000000\r\nkeep_classes = 7\r\n".encode("utf-8-sig")
    )
    config = effective("--config", str(file))
    assert (config.resolution, config.memory, config.keep_classes) == (2, 2_000_000_000, (7,))
