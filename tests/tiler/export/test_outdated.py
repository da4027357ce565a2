"""Files of earlier runs: what holds stays, what does not is moved whole, and nothing else is touched."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tiler.errors import ConfigError
from tiler.export.tasks import outdated
from tiler.export.tasks.outdated import archive, archive_outdated, archive_sidecars
from tiler.runs.file_digests import FileContent
from tiler.runs.record import Results


def write(out: Path, *paths: str) -> None:
    for path in paths:
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_text(f"content of {path}")


def files(out: Path) -> set[str]:
    return {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}


def by_key(*paths: str) -> dict[str, str]:
    """Files that a run writes, by the keys of their tasks."""
    return {path: path for path in paths}


def job_in(
    out: Path,
    earlier: dict[str, str],
    stored: tuple[str, ...] = ("dtm.tif", "mask.tif"),
    **settings: Any,
) -> Any:
    """What stood for a run whose OUT holds the files of earlier ones: path -> what they were made of.

    The store knows the tasks ``stored``.
    """
    config = SimpleNamespace(**{"force": False, "verify": False, **settings})
    results = Results()
    results.earlier_outputs = earlier
    results.digests = {path: f"digest of {path}" for path in earlier}
    notes: list[str] = []
    plan = SimpleNamespace(config=config)
    return SimpleNamespace(
        products=str(out),
        plan=plan,
        results=results,
        notes=notes,
        note=lambda text, kind: notes.append(text),
        save=notes.append,
        store=SimpleNamespace(committed=lambda stage: dict.fromkeys(stored)),
    )


def test_what_holds_stays_and_what_does_not_is_moved(tmp_path: Path) -> None:
    write(tmp_path, "slope.tif", "dsm/dsm_0_0.tif", "dtm.tif", "mine.txt")
    earlier = {
        "slope.tif": "now",
        "dsm/dsm_0_0.tif": "before",
        "dtm.tif": "before",
        "gone.tif": "now",
    }
    job = job_in(tmp_path, earlier)
    archive_outdated(job, by_key("dtm.tif", "mask.tif"), "now")
    assert files(tmp_path) == {"slope.tif", "outdated/dsm/dsm_0_0.tif", "dtm.tif", "mine.txt"}
    assert (tmp_path / "outdated/dsm/dsm_0_0.tif").read_text() == "content of dsm/dsm_0_0.tif"
    assert not (tmp_path / "dsm").exists()
    assert vars(job.results) == {
        "outputs": {"slope.tif": len("content of slope.tif")},
        "digests": {"slope.tif": "digest of slope.tif"},
        "made_of": {"slope.tif": "now"},
        "earlier_outputs": {"dtm.tif": None, "mask.tif": None},
    }
    moved, saved = job.notes
    assert moved.startswith(
        "dsm/dsm_0_0.tif: written by an earlier run with other settings or inputs"
    )
    assert moved.endswith("moved to outdated/")
    assert saved == "running"


def test_a_wanted_file_that_no_run_made_is_refused(tmp_path: Path) -> None:
    write(tmp_path, "dtm.tif")
    with pytest.raises(
        ConfigError, match=r"dtm\.tif: already exists and was not written by a run"
    ):
        archive_outdated(job_in(tmp_path, {}), by_key("dtm.tif", "mask.tif"), "now")
    archive_outdated(job_in(tmp_path, {}, force=True), by_key("dtm.tif"), "now")
    archive_outdated(job_in(tmp_path, {"dtm.tif": "before"}), by_key("dtm.tif"), "now")
    assert files(tmp_path) == {"dtm.tif"}


def test_paths_that_lead_out_of_the_folder_move_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(tmp_path, "secret.tif", "elsewhere/a.tif", "out/folder/b.tif")
    (out / "link").symlink_to(tmp_path / "elsewhere")
    before = files(tmp_path)
    paths = ["../secret.tif", str(tmp_path / "secret.tif"), "link/a.tif", "folder"]
    archive_outdated(job_in(out, dict.fromkeys(paths, "before")), {}, "now")
    assert files(tmp_path) == before


def file_digests(job: Any, stage: str, found: Any, in_out: bool) -> Any:
    """Content of files, of which dsm.tif has changed."""
    for place, _, _ in found:
        name = Path(place).name
        yield (
            place,
            FileContent("other bytes" if name == "dsm.tif" else f"digest of {name}", ""),
        )


@pytest.mark.parametrize(("stored", "is_moved"), [((), True), (("dsm.tif",), False)])
def test_a_changed_file_that_a_new_store_does_not_know_is_moved(
    stored: tuple[str, ...], is_moved: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that the store knows are compared with its records when their tasks begin."""
    write(tmp_path, "slope.tif", "dsm.tif")
    monkeypatch.setattr(outdated, "file_digests", file_digests)
    job = job_in(tmp_path, {"slope.tif": "now", "dsm.tif": "now"}, stored)
    archive_outdated(job, by_key("slope.tif", "dsm.tif"), "now")
    assert files(tmp_path) == {"slope.tif", "outdated/dsm.tif" if is_moved else "dsm.tif"}
    told = "dsm.tif: changed since a run wrote them; moved to outdated/ and made again"
    assert (told in job.notes) == is_moved


def test_a_damaged_file_that_is_not_made_again_is_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, "slope.tif", "dsm.tif")
    monkeypatch.setattr(outdated, "file_digests", file_digests)
    job = job_in(tmp_path, {"slope.tif": "now", "dsm.tif": "now"}, verify=True)
    archive_outdated(job, by_key("dtm.tif"), "now")
    assert files(tmp_path) == {"slope.tif", "outdated/dsm.tif"}
    assert list(job.results.made_of) == ["slope.tif"]
    assert job.notes[0].startswith("dsm.tif: changed since a run wrote it; moved to outdated/")


def test_files_are_moved_together_and_replace_none(tmp_path: Path) -> None:
    job = job_in(tmp_path, {})
    for number, folder in enumerate(["outdated", "outdated/2", "outdated/3"]):
        write(tmp_path, "dtm.tif", f"only_{number}.tif")
        assert archive(job, ["dtm.tif", f"only_{number}.tif"]) == folder
        assert (tmp_path / folder / f"only_{number}.tif").exists()
    assert len(files(tmp_path)) == 6


def test_sidecars_go_with_their_raster_and_styles_stay(tmp_path: Path) -> None:
    derived = [
        "slope.tif.ovr",
        "slope.tif.aux.xml",
        "slope.tif.msk",
        "slope.tif.msk.ovr",
        "slope.aux",
    ]
    kept = {"slope.qml", "slope.qmd", "slope.tif.txt", "mask.tif", "mask.tif.aux.xml"}
    write(tmp_path, "slope.tif", *derived, *kept)
    earlier = {"slope.tif": "before", "mask.tif": "now", "mask.tif.aux.xml": "now"}
    written = ("mask.tif", "mask.tif.aux.xml")
    archive_outdated(job_in(tmp_path, earlier, written), by_key(*written), "now")
    assert files(tmp_path) == {f"outdated/{name}" for name in ("slope.tif", *derived)} | kept


def test_sidecars_of_a_mosaic_go_if_its_sheets_are_replaced(tmp_path: Path) -> None:
    """The VRT has the same bytes as before."""
    write(tmp_path, "dtm.vrt.ovr", "slope.vrt.ovr", "dtm/a.tif.aux.xml", "mask.tif.aux.xml")
    job = job_in(tmp_path, {"mask.tif.aux.xml": "now"})
    archive_sidecars(job, ["dtm/a.tif", "mask.tif"])
    moved = {"outdated/dtm.vrt.ovr", "outdated/dtm/a.tif.aux.xml"}
    assert files(tmp_path) == moved | {"slope.vrt.ovr", "mask.tif.aux.xml"}
    (note,) = job.notes
    assert note.startswith("dtm.vrt.ovr, dtm/a.tif.aux.xml: made by another program from files")
    archive_sidecars(job, ["dtm/a.tif", "mask.tif"])
    assert job.notes == [note]


@pytest.mark.parametrize("suffix", ["-wal", "-journal"])
@pytest.mark.parametrize("written", [("contours.gpkg",), ()])
def test_an_open_geopackage_is_refused_before_anything_moves(
    written: tuple[str, ...], suffix: str, tmp_path: Path
) -> None:
    write(tmp_path, "slope.tif", "contours.gpkg", f"contours.gpkg{suffix}")
    job = job_in(tmp_path, {"slope.tif": "before", "contours.gpkg": "before"})
    before = files(tmp_path)
    with pytest.raises(ConfigError, match=f"contours.gpkg{suffix}: its GeoPackage is open"):
        archive_outdated(job, by_key(*written), "now")
    with pytest.raises(ConfigError, match=f"contours.gpkg{suffix}: its GeoPackage is open"):
        archive(job, ["slope.tif", "contours.gpkg"])
    assert files(tmp_path) == before


def test_an_empty_journal_that_a_closed_program_left_is_no_reason_to_refuse(
    tmp_path: Path,
) -> None:
    write(tmp_path, "contours.gpkg")
    (tmp_path / "contours.gpkg-journal").touch()
    assert archive(job_in(tmp_path, {}), ["contours.gpkg"]) == "outdated"
    (tmp_path / "contours.gpkg-wal").touch()
    write(tmp_path, "contours.gpkg")
    with pytest.raises(ConfigError, match="contours.gpkg-wal: its GeoPackage is open"):
        archive(job_in(tmp_path, {}), ["contours.gpkg"])
