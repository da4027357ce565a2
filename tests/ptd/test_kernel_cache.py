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
from types import SimpleNamespace
from typing import Any

import numba
import pytest

from ptd import kernel

needs_owners = pytest.mark.skipif(
    not hasattr(os, "getuid"), reason="Windows does not tell who may write"
)


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The cache of an image, owned by a user in place of root, and another user with a home.

    It lies in a place of its own, because all folders above it must belong to that user, unlike
    the system's scratch.
    """
    if not hasattr(os, "getuid"):
        pytest.skip("Windows does not tell who may write")
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


def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide the caches of this machine: those of root would be copied."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    temporary = SimpleNamespace(
        gettempdir=lambda: str(tmp_path / "temporary"),
        TemporaryDirectory=tempfile.TemporaryDirectory,
    )
    monkeypatch.setattr(kernel, "tempfile", temporary)


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of this user, with the machine code of `twice`."""
    alone(tmp_path, monkeypatch)
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


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for NUMBA_CACHE_DIR, next to the folder of the user's cache."""
    alone(tmp_path, monkeypatch)
    yield tmp_path
    monkeypatch.undo()
    kernel.cache_folder.cache_clear()


def chosen(parent: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str | None]:
    """Name of the folder in `places` that has the cache, and the note for the user."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(parent))
    kernel.cache_folder.cache_clear()
    folder = kernel.cache_folder()
    assert folder is not None
    return folder.parent.parent.name, kernel.cache_refusal()


@needs_owners
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o757])
@pytest.mark.parametrize("below", ["", "team/mine"])
def test_a_folder_in_an_open_folder_is_refused(
    mode: int, below: str, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = places / "shared"
    shared.mkdir()
    shared.chmod(mode)
    name, told = chosen(shared / below, monkeypatch)
    assert name == "home"
    assert list(shared.iterdir()) == []
    assert told is not None
    assert told.startswith(f"{shared}: other users can write to it")
    assert "\n" not in told
    command = told.partition("run `")[2].partition("`")[0]
    subprocess.run(command.split(), check=True)
    assert chosen(shared / below, monkeypatch) == (below[5:] or "shared", None)


@pytest.mark.parametrize("umask", [0, 0o002, 0o022, 0o077])
def test_a_new_folder_is_closed_for_any_umask(
    umask: int, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = os.umask(umask)
    try:
        for _ in range(2):
            assert chosen(places / "a" / "b", monkeypatch) == ("b", None)
            assert compilations() in (0, 1)
    finally:
        os.umask(before)
    assert compilations() == 0


@needs_owners
def test_the_sticky_bit_protects_own_folders(
    places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch = places / "scratch"
    scratch.mkdir()
    scratch.chmod(0o1777)
    assert chosen(scratch / "mine", monkeypatch) == ("mine", None)
    (scratch / "mine" / "tiler-kernels").chmod(0o1777)
    # Entries of a folder with the sticky bit may be those of any user.
    (cache,) = (scratch / "mine" / "tiler-kernels").iterdir()
    assert chosen(scratch / "mine", monkeypatch)[0] == "mine"
    cache.chmod(0o1777)
    assert chosen(scratch / "mine", monkeypatch)[0] == "home"


@pytest.mark.parametrize("link", ["shared/way", "way"])
def test_links_are_followed_to_what_they_lead_to(
    link: str, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, mode in (("shared", 0o777), ("closed", 0o755)):
        (places / name).mkdir()
        (places / name).chmod(mode)
    end = "../closed" if link.startswith("shared") else "shared"
    (places / link).symlink_to(end)
    name, told = chosen(places / link, monkeypatch)
    assert name == "home"
    assert told is not None
    assert told.startswith(f"{places / 'shared'}: ")
    (places / "round").symlink_to("round")
    assert chosen(places / "round", monkeypatch)[0] == "home"
    (places / "good").symlink_to("closed/../closed")
    assert chosen(places / "good", monkeypatch) == ("good", None)


@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can give files away"
)
@pytest.mark.parametrize("place", ["", "mine", "mine/tiler-kernels", "cache", "cache/entry"])
def test_files_and_folders_of_another_user_are_refused(
    place: str, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parent = places / "foreign" / "mine"
    assert chosen(parent, monkeypatch)[0] == "mine"
    (cache,) = (parent / "tiler-kernels").iterdir()
    (cache / "entry").touch()
    path = (
        cache.joinpath(*place.split("/")[1:])
        if "cache" in place
        else places / "foreign" / place
    )
    os.chown(path, 65534, -1)
    name, told = chosen(parent, monkeypatch)
    assert name == "home"
    assert told is not None
    assert told.startswith(f"{path}: ")
    assert "delete" in told if "entry" in place else "set NUMBA_CACHE_DIR" in told


@needs_owners
def test_code_of_another_user_does_not_run(own: Path, tmp_path: Path) -> None:
    """A checksum does not protect, since the other user can compute it as well."""
    (index,) = own.rglob("*.twice*.nbi")
    harm = b"cos\nsystem\n(S'touch " + os.fsencode(tmp_path / "harm") + b"'\ntR."
    content = pickle.dumps(numba.__version__) + harm
    index.write_bytes(content + kernel._checksum(content))
    own.chmod(0o777)
    kernel.cache_folder.cache_clear()
    assert compilations() == 1
    assert not (tmp_path / "harm").exists()
    own.chmod(0o700)
    kernel.cache_folder.cache_clear()
    assert compilations() == 1
    assert (tmp_path / "harm").exists(), "the test would not notice the harm"


def test_a_path_that_the_system_refuses_is_skipped(
    places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The home folder of another user may be unreadable as well."""
    name, _ = chosen(places / ("n" * 300) / "a", monkeypatch)
    assert name == "home"
    assert not kernel._trusted(places / ("n" * 300))


def test_without_owners_of_files_each_folder_is_used(
    places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows has no owners."""
    (places / "shared").mkdir()
    (places / "shared").chmod(0o777)
    monkeypatch.delattr(os, "getuid", raising=False)
    assert chosen(places / "shared", monkeypatch) == ("shared", None)
    assert not kernel._trusted(places / "shared"), (
        "code of a folder that others write is copied"
    )


def test_a_user_without_a_home_keeps_kernels_among_the_temporary_files(
    places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    monkeypatch.chdir(places)
    (places / "file").touch()
    user = os.getuid() if hasattr(os, "getuid") else "user"
    assert chosen(places / "file", monkeypatch) == (f"cache-{user}", None)
    assert not (places / "~").exists()


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
    not hasattr(os, "geteuid") or os.geteuid() != 0 or not reaches_python(65534),
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
