"""The place of machine code, and the owners whose code is trusted."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ptd import kernel


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The cache of an image, owned by a user in place of root, and another user with a home.

    It lies in a place of its own, because all folders above it must belong to that user, unlike
    the system's scratch.
    """
    me = os.getuid()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "image"))
    kernel.cache_folder.cache_clear()
    folder = kernel.cache_folder()
    assert folder is not None
    assert folder.is_relative_to(tmp_path / "image")
    (folder / "ptd_1").mkdir()
    (folder / "ptd_1" / "a.nbc").write_bytes(b"code")
    (folder / "classic.compiled").touch()
    monkeypatch.setattr(kernel, "_ROOT", me)
    real = Path.stat

    def plain(path: Path, **options: bool) -> os.stat_result:
        """Let the folders above belong to the same user, as in an image."""
        found = real(path, **options)
        if path in tmp_path.parents or path == tmp_path:
            return os.stat_result((0o40755, *found[1:4], me, *found[5:]))
        return found

    monkeypatch.setattr(Path, "stat", plain)
    monkeypatch.setattr(os, "getuid", lambda: me + 1)
    kernel.cache_folder.cache_clear()
    yield folder
    monkeypatch.undo()
    kernel.cache_folder.cache_clear()


def own_of_a_stranger(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path | None:
    """The folder of another user. The test cannot make files of another user, so these count as theirs."""
    monkeypatch.setattr(
        kernel, "_usable", lambda path: path.is_relative_to(tmp_path / "home") and path.exists()
    )
    return kernel.cache_folder()


def test_the_cache_of_an_image_is_copied(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = own_of_a_stranger(shared, tmp_path, monkeypatch)
    assert folder == tmp_path / "home" / "tiler-kernels" / shared.name
    assert (folder / "ptd_1" / "a.nbc").read_bytes() == b"code"
    assert (folder / "classic.compiled").exists()
    assert folder.stat().st_mode & 0o77 == 0
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.parametrize("open_place", ["", "ptd_1", "ptd_1/a.nbc", "../.."])
def test_a_cache_that_others_can_write_is_not_copied(
    open_place: str, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = shared / open_place
    place.chmod(0o777)
    folder = own_of_a_stranger(shared, tmp_path, monkeypatch)
    copied = folder is not None and (folder / "ptd_1" / "a.nbc").exists()
    assert not copied


def test_a_link_to_another_place_is_not_copied(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").write_bytes(b"other code")
    (tmp_path / "elsewhere").chmod(0o666)
    (shared / "ptd_1" / "b.nbc").symlink_to(tmp_path / "elsewhere")
    folder = own_of_a_stranger(shared, tmp_path, monkeypatch)
    assert folder is not None
    assert not (folder / "ptd_1" / "b.nbc").exists()


def twice(value: int) -> int:
    return 2 * value


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of this user, with the machine code of `twice`."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    kernel.cache_folder.cache_clear()
    assert compilations() == 1
    folder = kernel.cache_folder()
    assert folder is not None
    assert folder.is_relative_to(tmp_path / "own")
    yield folder
    monkeypatch.undo()
    kernel.cache_folder.cache_clear()


def compilations() -> int:
    """How often `twice` is compiled where a new process calls it."""
    fresh: Any = kernel.kernel(twice)
    assert fresh(21) == 42
    return sum(fresh.stats.cache_misses.values())


def of_another_version(content: bytes) -> bytes:
    """An index as another version of numba writes it, followed by what this one cannot unpickle."""
    return pickle.dumps("0.1.0") + b"unknown" + content[-3:]


def with_a_checksum(content: bytes) -> bytes:
    """A file that was written completely, but whose content this software does not know."""
    return b"other" + kernel._checksum(b"other")


def with_a_flipped_bit(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: bytes(len(content)),
        lambda content: b"garbage" * 99,
        with_a_flipped_bit,
        with_a_checksum,
        of_another_version,
    ],
    ids=["empty", "half", "zeros", "garbage", "bit", "unknown", "version"],
)
def test_a_damaged_file_is_compiled_again(
    damage: Callable[[bytes], bytes],
    suffix: str,
    own: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert compilations() == 0
    (file,) = own.rglob(f"*.twice*{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compilations() == 1
    assert compilations() == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_folder_in_place_of_a_file_leaves_the_kernel_usable(suffix: str, own: Path) -> None:
    (file,) = own.rglob(f"*.twice*{suffix}")
    file.unlink()
    file.mkdir()
    assert compilations() == 1
    assert file.is_dir()


def test_a_file_in_place_of_the_folder_of_a_module_leaves_the_kernel_usable(own: Path) -> None:
    """numba's own choice would be a folder next to the source."""
    (file,) = own.rglob("*.twice*.nbi")
    shutil.rmtree(file.parent)
    file.parent.touch()
    fresh: Any = kernel.kernel(twice)
    assert fresh(21) == 42
    assert fresh.stats.cache_path is None


def test_damaged_files_and_marks_are_discarded(own: Path) -> None:
    (own / "auto-dim.compiled").touch()
    assert kernel.discard_damaged() == 0
    (own / "notes.txt").touch()
    (index,), (code,) = own.rglob("*.twice*.nbi"), own.rglob("*.twice*.nbc")
    code.write_bytes(b"")
    assert kernel.discard_damaged() == 1
    assert sorted(p for p in own.rglob("*") if p.is_file()) == [own / "notes.txt", index]


def reaches_python(user: int) -> bool:
    try:
        subprocess.run(
            [sys.executable, "-c", "import numba"],
            user=user,
            group=user,
            extra_groups=[],
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return True


@pytest.mark.processes
@pytest.mark.skipif(
    os.geteuid() != 0 or not reaches_python(65534),
    reason="no other user can start this Python, or this user cannot become another",
)
def test_another_user_has_the_kernels_of_root() -> None:
    """Both run in processes of their own; the second compiles nothing."""
    with (
        tempfile.TemporaryDirectory(dir="/var/cache") as image,
        tempfile.TemporaryDirectory() as home,
    ):
        os.chmod(image, 0o755)
        os.chmod(home, 0o777)
        script = "import ptd.kernel as k; k.wide(1); print(k.cache_folder(), sum(k.wide.stats.cache_misses.values()))"
        variables = {
            **os.environ,
            "NUMBA_CACHE_DIR": image,
            "XDG_CACHE_HOME": f"{home}/user",
            "HOME": home,
        }

        def told(user: int) -> list[str]:
            who: dict[str, Any] = {"user": user, "group": user, "extra_groups": []}
            call = [sys.executable, "-c", script]
            return subprocess.check_output(call, env=variables, text=True, **who).split()

        assert told(0)[1] == "1"
        # as the Dockerfile does
        subprocess.run(["chmod", "-R", "a+rX,go-w", image], check=True)
        folder, misses = told(65534)
        assert folder.startswith(f"{home}/user/")
        assert misses == "0"
