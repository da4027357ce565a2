"""Folders as people have them, made by hypothesis, and commands on them: what was there before is there after."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import laspy
import numpy as np
import rasterio
from affine import Affine
from hypothesis import strategies as st

from cli.main import main

ODD = ("with space.las", "new\nline.las", "\x1b[31mred.las", "-o.las", "\udcff.las", "ü.laz")
CLOUDS = ("a.las", "A.LAS", "b.laz", *ODD)
FOLDERS = tuple(
    "in in/sub IN out out/classified out/outdated out/store.zarr out/dtm store pictures".split()  # noqa: SIM905
)
OTHERS = tuple(
    """notes.txt dtm.tif dtm.vrt DTM.tif run.json events.jsonl report.html check.json zarr.json a.laz p.png d.tif
    x.partial dtm.tif.plain.partial run.json.partial c 0 index lock.json""".split()  # noqa: SIM905
)
RESULTS = tuple(
    "dtm.tif run.json events.jsonl report.html classified/a.laz stac.json x.partial".split()  # noqa: SIM905
)
"""Names in OUT that a run writes or `tiler clean` might remove."""
WRITTEN_ANEW = ("run.json", "events.jsonl", "report.html", "check.json")
WEST, SOUTH, SIDE = 500_000.0, 5_400_000.0, 12.0


@dataclass
class Tree:
    """A folder, and which files in it a command made: these may change, all others may not."""

    root: Path
    made: dict[str, str] = field(default_factory=dict)

    def state(self) -> dict[str, str]:
        """Path -> digest of each file, target of each link; links are not followed."""
        found = {}
        for folder, folders, files in os.walk(self.root):
            for name in [
                *files,
                *(f for f in folders if os.path.islink(os.path.join(folder, f))),
            ]:
                path = os.path.join(folder, name)
                place = os.path.relpath(path, self.root)
                if os.path.islink(path):
                    found[place] = f"-> {os.readlink(path)}"
                else:
                    with open(path, "rb") as stream:
                        found[place] = hashlib.blake2b(
                            stream.read(), digest_size=16
                        ).hexdigest()
        return found

    def harmed(self, before: dict[str, str], named: set[str]) -> list[str]:
        """Files of the user that are not what they were; what commands made is known from now on.

        A file that the user put in the place of a result may have been moved aside, whole. The
        files that each run writes anew stay the run's.
        """
        after = self.state()
        aside = {digest for place, digest in after.items() if "outdated" in place.split(os.sep)}
        own = {place for place, digest in before.items() if self.made.get(place) == digest}
        results = set(self.made)
        found = []
        for place, digest in before.items():
            if place in own or place in named or after.get(place) == digest:
                continue
            if place in results and (
                digest in aside or os.path.basename(place) in WRITTEN_ANEW
            ):
                continue
            found.append(place)
        for place, digest in after.items():
            if before.get(place) != digest and place not in found:
                self.made[place] = digest
        return found


@cache
def cloud_bytes(suffix: str, seed: int) -> bytes:
    """A slope of a few points as a file."""
    random = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.array([WEST, SOUTH, 0.0]), np.full(3, 0.01)
    las = laspy.LasData(header)
    x, y = random.random((2, 60)) * SIDE
    las.x, las.y, las.z = WEST + x, SOUTH + y, 100 + 0.1 * x + 0.01 * seed
    las.classification[:] = np.where(random.random(60) < 0.9, 2, 1)
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    with tempfile.TemporaryDirectory() as folder:
        las.write(Path(folder) / f"x{suffix}")
        return (Path(folder) / f"x{suffix}").read_bytes()


@cache
def raster_bytes() -> bytes:
    """Heights of the slope."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "d.tif"
        heights = np.full((12, 12), 100, np.float32) + 0.1 * np.arange(12, dtype=np.float32)
        grid = {"crs": "EPSG:25832", "transform": Affine(1, 0, WEST, 0, -1, SOUTH + SIDE)}
        values = {"height": 12, "width": 12, "count": 1, "dtype": "float32", "nodata": -9999.0}
        with rasterio.open(path, "w", driver="GTiff", **grid, **values) as raster:
            raster.write(heights, 1)
        return path.read_bytes()


def content(kind: str, seed: int) -> bytes:
    """Bytes of a file of some kind."""
    if kind in (".las", ".laz"):
        return cloud_bytes(kind, seed)
    if kind == "points":
        lines = (b"%.1f,%.1f,100.4\n" % (WEST + i, SOUTH + i) for i in range(2, 9))
        return b"x,y,z\n" + b"".join(lines)
    if kind == "raster":
        return raster_bytes()
    return {"text": b"mine %d\n" % seed, "empty": b"", "json": b'{"state": "done"}'}[kind]


one = st.sampled_from


def within(folders: tuple[str, ...], names: tuple[str, ...]) -> st.SearchStrategy[str]:
    return st.builds("{}/{}".format, one(folders), one(names))


ANYWHERE = st.one_of(
    within(("in", "in", "in/sub", *FOLDERS), CLOUDS),
    within((*FOLDERS, "out"), OTHERS),
    one(("a.las", "notes.txt", "d.tif", "preview.png")),
)
PLACES = st.one_of(ANYWHERE, ANYWHERE, within(("out",), RESULTS))
"""Where things lie."""

THINGS = st.tuples(
    PLACES,
    one(
        (
            "file",
            "file",
            "file",
            "file",
            "file",
            "link",
            "hard link",
            "folder",
            "link to folder",
        )
    ),
    one(("text", "raster", "empty", "json", ".las", ".laz")),
    st.integers(0, 3),
    st.one_of(PLACES, one(FOLDERS)),
)


KINDS = {".las": ".las", ".laz": ".laz", ".json": "json"}
"""Kinds of files that their suffix decides."""


def put(tree: Tree, thing: tuple[str, str, str, int, str]) -> None:
    """Put a thing into the tree, as its owner does; where there is no room for it, nothing."""
    place, what, kind, seed, target = thing
    path, other = tree.root / place, tree.root / target
    suffix = os.path.splitext(place)[1].lower()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        if what == "folder":
            path.mkdir()
        elif what == "link":
            path.symlink_to(os.path.relpath(other, path.parent))
        elif what == "link to folder":
            folder = tree.root / os.path.dirname(place)
            (folder.parent / f"{folder.name}-link").symlink_to(folder.name)
        elif what == "hard link":
            os.link(other, path)
        else:
            data = content(KINDS.get(suffix, kind), seed)
            if path.is_symlink():
                path.unlink()
            path.write_bytes(data)


SOME = ("in", ".", "in/sub", "IN", "a.las", "in/a.las", "in/*.la?", "out", "in-link")
INPUTS = st.one_of(st.just(["in"]), st.lists(one(SOME), min_size=1, max_size=2))
OUTS = st.one_of(
    st.just("out"),
    one(("in", ".", "out/classified", "in/sub", "new", "out-link", "pictures", "a.las")),
)
STORES = st.one_of(
    st.none(), one((None, "store", "out", "in", "out/classified", "out-link", "."))
)
MORE_OPTIONS = (
    "--overwrite",
    "--clean-store",
    "--verify",
    "--sheets=6",
    "--products=dtm,hillshade",
)
FLAGS = st.lists(one(MORE_OPTIONS), max_size=2, unique=True)
ANY = ("in/a.las", "out/run.json", "notes.txt", "d.tif", "in-link/a.las", "in/A.LAS", "out")
CLOUD_FILES = ("in/a.las", "a.las", "in/b.laz", "in-link/b.laz", "out/classified/a.laz")
SOURCES = st.one_of(one(CLOUD_FILES), one(CLOUD_FILES), one(ANY))
NEW_CLOUDS = ("new/x.laz", "out/classified/a.laz", "in/b.laz", "a.laz", "IN/a.laz", "out/a.laz")
TARGETS = st.one_of(one(NEW_CLOUDS), one(NEW_CLOUDS), one(ANY))
PICTURES = one(
    ("preview.png", "pictures/p.png", "in/p.png", "out/p.png", "out-link/p.png", *ANY)
)
RASTERS = one(
    ("out/dtm.tif", "d.tif", "d.tif", "in/d.tif", "out/dtm.vrt", "out-link/dtm.tif", *ANY)
)


def run_line(
    inputs: list[str], out: str, store: str | None, flags: list[str], stage: str, method: str
) -> list[str]:
    """Arguments of a run, or of a stage of it."""
    chosen = [] if store is None else ["--store", store]
    how = ["--method", method, "--crs", "EPSG:25832", "--in-process"]
    return [stage, *inputs, "-o", out, *how, *chosen, *flags, "-q"]


METHODS = one(("keep", "keep", "classic"))
COMMANDS = st.one_of(
    st.builds(
        run_line,
        INPUTS,
        OUTS,
        STORES,
        FLAGS,
        one(("run", "run", "run", "ingest", "grid")),
        METHODS,
    ),
    st.builds(
        lambda out, store: ["clean", out, *(["--store", store] if store else [])], OUTS, STORES
    ),
    st.builds(lambda out: ["report", out, "-q"], OUTS),
    st.builds(
        lambda i, o: ["preview", *i, "-o", o, "--method", "keep", "--crs", "EPSG:25832", "-q"],
        INPUTS,
        PICTURES,
    ),
    st.builds(lambda i, o: ["classify", i, o, "--method", "classic", "-q"], SOURCES, TARGETS),
    st.builds(
        lambda d, t, o: ["evaluate", "--dtm", d, "--true-dtm", t, "--difference", o, "-q"],
        *(RASTERS, RASTERS, RASTERS),
    ),
    st.builds(
        lambda c, m: ["evaluate", c, "--reference", "in", "--maps", m, "-q"], SOURCES, OUTS
    ),
    st.builds(
        lambda d, f: ["check", d, "--points", "points.csv", "--figures", f, "-q"], RASTERS, OUTS
    ),
)


def named_by(arguments: list[str]) -> set[str]:
    """The one file that a command is told to write; it is replaced, as its help says, unless it is refused."""
    command = arguments[0]
    if command == "classify":
        return {os.path.normpath(arguments[2])}
    for option in ("-o", "--difference"):
        if option in arguments and command in ("preview", "evaluate"):
            return {os.path.normpath(arguments[arguments.index(option) + 1])}
    return set()


RUNS = st.builds(run_line, INPUTS, st.just("out"), STORES, FLAGS, st.just("run"), METHODS)
COMMAND = st.tuples(st.just("command"), COMMANDS)
MORE = st.lists(
    st.one_of(st.tuples(st.just("put"), THINGS), COMMAND, COMMAND), min_size=1, max_size=3
)
STEPS = st.one_of(MORE, st.builds(lambda first, rest: [("command", first), *rest], RUNS, MORE))
TREES = st.lists(THINGS, min_size=2, max_size=9)
BEGINNING = {
    "in/a.las": "",
    "in/b.laz": "",
    "a.las": "",
    "d.tif": "raster",
    "points.csv": "points",
}
"""Files of every tree, and their kinds."""


@contextlib.contextmanager
def planted(things: list[tuple[str, str, str, int, str]]) -> Iterator[Tree]:
    """A tree of things, which is the current folder; it always has clouds, a raster and checkpoints to begin with."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as scratch:
        tree = Tree(Path(scratch).resolve() / "tree")
        for place, kind in BEGINNING.items():
            put(tree, (place, "file", kind, 0, ""))
        for thing in things:
            put(tree, thing)
        os.chdir(tree.root)
        try:
            yield tree
        finally:
            os.chdir(before)


def tried(tree: Tree, arguments: list[str]) -> None:
    """Run a command; raises AssertionError where it harmed a file, or ended in a way that nobody planned."""
    before = tree.state()
    named = named_by(arguments)
    inputs = {path for path in named if is_read(path, arguments)}
    told = io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(told):
        code = main(arguments)
    assert "unexpected " not in told.getvalue(), (arguments, told.getvalue())
    harmed = tree.harmed(before, named)
    assert not harmed, f"{arguments} harmed {harmed} (code {code})"
    after = tree.state()
    assert all(after.get(path) == before[path] for path in inputs), (
        f"{arguments} wrote over its input"
    )
    assert code in (0, 2, 3, 4, 5, 6), (arguments, code)


def is_read(target: str, arguments: list[str]) -> bool:
    """Whether a file that a command is told to write is also one that it reads, perhaps by another name."""
    if not os.path.isfile(target):
        return False
    others = list(arguments[1:])
    for argument in arguments:
        if os.path.normpath(argument) == target:
            others.remove(argument)
            break
    return any(os.path.isfile(other) and os.path.samefile(other, target) for other in others)
