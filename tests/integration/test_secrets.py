"""Passwords and tokens of URLs: used to open what they protect, shown and kept nowhere."""

from __future__ import annotations

import base64
import http.server
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli.main import main
from tests.integration.command import tiler
from tests.invariants import clouds

pytest.importorskip("upath")
pytest.importorskip("aiohttp")

PASSWORD, TOKEN = "hunter2pass", "tok3n-of-today"
SECRETS = (PASSWORD, TOKEN, base64.b64encode(f"anna:{PASSWORD}".encode()).decode())
OPTIONS = (
    "--method",
    "classic",
    "--workers",
    1,
    "--resolution",
    1,
    "--tile-size",
    64,
    "--halo",
    80,
)


class Guarded(http.server.SimpleHTTPRequestHandler):
    """Gives parts of files to whoever knows the password, and some token."""

    protocol_version = "HTTP/1.1"
    folder: Path

    def do_HEAD(self) -> None:
        self.do_GET(body=False)

    def do_GET(self, body: bool = True) -> None:
        name, _, query = self.path.partition("?")
        file = self.folder / name.strip("/")
        if self.headers.get("Authorization") != f"Basic {SECRETS[2]}" or not query.startswith(
            "token="
        ):
            return self.answer(401)
        if not file.is_file():
            return self.answer(404)
        data = file.read_bytes()
        if found := re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or ""):
            first, last = int(found[1]), min(int(found[2] or len(data)), len(data) - 1)
            return self.answer(
                206, data[first : last + 1], f"bytes {first}-{last}/{len(data)}", body
            )
        return self.answer(200, data, None, body)

    def answer(
        self, code: int, data: bytes = b"", part: str | None = None, body: bool = True
    ) -> None:
        self.send_response(code)
        if part is not None:
            self.send_header("Content-Range", part)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if body:
            self.wfile.write(data)

    def log_message(self, *arguments: object) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """``127.0.0.1:port`` of a server with a cloud, and one that is no cloud."""
    folder = tmp_path_factory.mktemp("served")
    clouds.write(folder / "town.laz", clouds.city(60.0))
    (folder / "broken.laz").write_bytes(b"LASF" + bytes(400))
    handler = type("Handler", (Guarded,), {"folder": folder})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()


def assert_secret(folder: Path, *texts: str) -> None:
    """No secret in the texts, nor in any file of the folder or its name."""
    contents = {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    contents |= {f"stream {n}": text.encode() for n, text in enumerate(texts)}
    for place, content in contents.items():
        for secret in SECRETS:
            assert secret not in place
            assert secret.encode() not in content, f"{secret} in {place}"


@pytest.mark.processes
@pytest.mark.slow
def test_no_output_of_a_run_holds_a_secret_and_it_resumes(
    host: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], logging_as_before: None
) -> None:
    out = tmp_path / "out"
    cloud = f"http://anna:{PASSWORD}@{host}/town.laz?token={TOKEN}"
    broken = f"http://anna:{PASSWORD}@{host}/broken.laz?token={TOKEN}"
    products = ("--products", "dtm,slope", "--sheets", "100")
    done = tiler("run", cloud, broken, "-o", out, *OPTIONS, *products, "-vv")
    assert done.returncode == 5, done.stderr
    assert f"http://{host}/broken.laz: left out" in done.stderr
    assert (out / "classified" / "town.laz").is_file()
    assert_secret(out, done.stdout, done.stderr)
    # Signed anew, as such links are each day: the same file, and nothing to do.
    again = tiler(
        "run", cloud.replace(TOKEN, "tok3n-of-tomorrow"), "-o", out, *OPTIONS, *products
    )
    assert again.returncode == 0, again.stderr
    assert again.stdout.startswith("nothing to do")
    for command in (("plan", cloud), ("info", out), ("report", out), ("info", out / "dtm.vrt")):
        assert main([*map(str, command), "-vv"]) == 0
        assert_secret(out, *capfd.readouterr())


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "http://anna:{p}@{host}/gone.laz?token={t}", "-o", "out"),
        ("plan", "http://anna:wrong-{p}@{host}/town.laz?token={t}"),
        ("plan", "http://anna:{p}@127.0.0.1:1/town.laz?token={t}"),
        ("plan", "http://anna:{p}/unescaped@{host}/town.laz?token={t}"),
        ("plan", "http://anna:{p}@{host}/broken.laz?token={t}", "--json"),
        ("plan", "nosuch://anna:{p}@{host}/town.laz?token={t}"),
        ("info", "http://anna:{p}@{host}/town.laz?token={t}"),
        ("check", "http://anna:{p}@{host}/dtm.tif?token={t}", "--tile-size", 50),
        (
            "evaluate",
            "http://anna:{p}@{host}/a.laz?token={t}",
            "--reference",
            "https://{p}@{host}/b.laz",
        ),
        ("preview", "http://anna:{p}@{host}/broken.laz?token={t}"),
        ("classify", "http://anna:{p}@{host}/town.laz?token={t}", "out.laz"),
        ("clean", "out", "--store", "nosuch://anna:{p}@{host}/store?token={t}"),
        ("config", "--store", "ftp://anna:{p}@{host}/store?token={t}"),
        ("report", "http://anna:{p}@{host}/out?token={t}"),
    ],
    ids=lambda arguments: " ".join(map(str, arguments))[:24],
)
def test_no_error_holds_a_secret(
    arguments: tuple[str, ...],
    host: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    logging_as_before: None,
) -> None:
    monkeypatch.chdir(tmp_path)
    filled = [str(a).format(p=PASSWORD, t=TOKEN, host=host) for a in arguments]
    code = main([*filled, "-vv"])
    told = capfd.readouterr()
    assert code == 0 if arguments[0] == "info" else code in (0, 2, 3, 4), told.err
    assert_secret(tmp_path, *told)


def test_no_object_of_a_store_and_no_result_at_a_url_holds_a_secret(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    logging_as_before: None,
) -> None:
    from fsspec.implementations.memory import MemoryFileSystem

    monkeypatch.setattr(MemoryFileSystem, "store", {})
    monkeypatch.setattr(MemoryFileSystem, "pseudo_dirs", [""])
    monkeypatch.chdir(tmp_path)
    clouds.write(tmp_path / "town.laz", clouds.city(60.0))
    out, store = (
        f"memory://anna:{PASSWORD}@host/out",
        f"memory://anna:{PASSWORD}@host/elsewhere",
    )
    call = [
        "run",
        "town.laz",
        "-o",
        out,
        "--store",
        store,
        "--in-process",
        *map(str, OPTIONS),
        "-vv",
    ]
    call += ["--products", "dtm,slope"]
    for _ in range(2):
        assert main(call) == 0
        assert_secret(tmp_path, *capfd.readouterr())
    assert (tmp_path / "out" / "report.html").read_text().count("data:image/png;base64,") == 2
    objects = {
        key.replace(PASSWORD, ""): file.getvalue()
        for key, file in MemoryFileSystem.store.items()
    }
    names = ("out/dtm.tif", "out/run.json", "elsewhere/zarr.json")
    assert {f"/anna:@host/{name}" for name in names} <= objects.keys()
    for key, content in objects.items():
        for secret in SECRETS:
            assert secret not in key
            assert secret.encode() not in content, key
