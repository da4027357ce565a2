"""Ledger of six small runs: digests of all files and labels that they write, for changes that may change none of them.

    python -m tests.ledger FOLDER [CORPUS ...] >before.txt

FOLDER is emptied. The report, the events, and times and memory in ``run.json`` are left out. The same command then runs
again, which must compute nothing. A third run is killed at the start of the terrain and resumed, which must give the
same. ``diff`` of the ledgers of two checkouts shows what a change changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from tests.scenes.copc_files import write_copc
from tests.scenes.ept_files import write_ept
from tests.scenes.running import wait_for
from tiler.core.products import PRODUCTS

LEFT_OUT = ("report.html", "events.jsonl", "run.json", "classified.vpc")
"""Files with times. Of ``run.json`` the rest is read."""
FACTS_LEFT_OUT = (
    "changes", "cpu_seconds", "delivered", "inputs", "libraries", "mtime_ns", "outputs", "peak_rss_bytes",
    "projected_seconds", "rates_of_this_machine", "seconds", "stages", "tiles",
    "version", "written",
)  # fmt: skip
"""Names in ``run.json`` of times, memory, the machine, the runs before, and what the work was divided into."""
KILLED_IN = "grid-dtm"
MOST_IN_NODE = 20_000
Arguments = list[str]


def command(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command of the checkout in a folder, so that no path in a result depends on where that is."""
    place = Path(__file__).parents[1]
    code = f"import sys; sys.path.insert(0, {str(place)!r}); from cli.main import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        text=True,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )


def do(folder: Path, *arguments: str) -> None:
    """Run a command to its end."""
    code = command(folder, *arguments).wait()
    if code:
        raise SystemExit(f"tests.ledger: tiler {' '.join(arguments)} ended with {code}")


def simulated(folder: Path, scene: str, size_m: int) -> Path:
    """Write the cloud of a scene as ``whole.laz``."""
    do(folder, "simulate", "whole.laz", "--scene", scene, "--size", str(size_m))
    return folder / "whole.laz"


def halves(cloud: Path) -> Arguments:
    """Cut a cloud into two files that overlap by 10 m, and return their names."""
    las, names = laspy.read(cloud), []
    x = np.asarray(las.x)
    middle = (x.min() + x.max()) / 2
    for name, chosen in (("west.laz", x < middle + 5), ("east.laz", x > middle - 5)):
        part = laspy.LasData(las.header)
        part.points = las.points[chosen]
        part.write(cloud.parent / name)
        names.append(name)
    cloud.unlink()
    return names


def drawn(path: Path, features: list[tuple[str, Any, dict[str, Any]]]) -> str:
    """Write features, each a kind of geometry, its coordinates and its columns, in the CRS of the cloud beside them."""
    crs = laspy.read(path.parent / "whole.laz").header.parse_crs()
    content = {
        "type": "FeatureCollection",
        "crs": {
            "type": "name",
            "properties": {"name": f"urn:ogc:def:crs:EPSG::{crs.to_epsg()}"},
        },
        "features": [
            {
                "type": "Feature",
                "properties": columns,
                "geometry": {"type": kind, "coordinates": coordinates},
            }
            for kind, coordinates, columns in features
        ],
    }
    path.write_text(json.dumps(content))
    return path.name


def square(x: float, y: float, side: float) -> list[list[list[float]]]:
    """Return the ring of a square from its south-west corner."""
    return [[[x, y], [x + side, y], [x + side, y + side], [x, y + side], [x, y]]]


def town(folder: Path) -> Arguments:
    """A laser scan in two files that overlap, with all rasters."""
    names = halves(simulated(folder, "als_suburb", 160))
    return [
        *names,
        "--products",
        ",".join(PRODUCTS),
        "--voids",
        "fill",
    ]


def matched(folder: Path) -> Arguments:
    """A photogrammetric cloud with a canopy, in two files that overlap."""
    names = halves(simulated(folder, "dim_forest", 120))
    return [*names, "--products", "dtm,dsm,mask,sigma", "--resolution", "0.5"]


def weir(folder: Path) -> Arguments:
    """A river with a dam."""
    return [
        simulated(folder, "als_weir", 400).name,
        "--products",
        "dtm,mask",
        "--outline",
        "hull",
    ]


def corrections(folder: Path) -> Arguments:
    """Edits, breaklines and bridges that are removed."""
    cloud = simulated(folder, "als_suburb", 200)
    x, y, z = (float(v) for v in laspy.read(cloud).header.mins)
    x, y = round(x), round(y)
    edits = [
        ("Polygon", square(x + 20, y + 20, 15), {"action": "not_ground"}),
        ("Polygon", square(x + 60, y + 40, 12), {"action": "flat", "z": round(z + 2, 1)}),
        ("Polygon", square(x + 100, y + 90, 10), {"action": "ground"}),
    ]
    line = [[x + 30, y + 120, z + 3], [x + 80, y + 125, z + 3.5], [x + 150, y + 140, z + 4]]
    return [
        cloud.name, "--edits", drawn(folder / "edits.geojson", edits), "--bridges", "remove",
        "--breaklines", drawn(folder / "lines.geojson", [("LineString", line, {})]),
    ]  # fmt: skip


def sheets(folder: Path) -> Arguments:
    """Sheets, contours and spot heights."""
    cloud = simulated(folder, "als_terraces", 160)
    return [
        cloud.name,
        "--products",
        "dtm,contours,spots",
        "--sheets",
        "100",
        "--contour-interval",
        "2",
    ]


def octrees(folder: Path) -> Arguments:
    """Parts of a COPC file and of an EPT data set."""
    las = laspy.read(simulated(folder, "als_city", 160))
    x, y, _ = (round(float(v)) for v in las.header.mins)
    write_copc(folder / "whole.copc.laz", las, MOST_IN_NODE)
    las.x = np.asarray(las.x) + 160
    write_ept(folder / "beside", las, MOST_IN_NODE)
    return [
        "whole.copc.laz",
        "beside/ept.json",
        "--bounds",
        *map(str, (x + 110, y + 20, x + 210, y + 120)),
    ]


CORPORA: tuple[Callable[[Path], Arguments], ...] = (
    town,
    matched,
    weir,
    corrections,
    sheets,
    octrees,
)


def facts(value: Any) -> Any:
    """Return the facts of a run that do not depend on the machine."""
    if isinstance(value, dict):
        return {
            name: facts(inner) for name, inner in value.items() if name not in FACTS_LEFT_OUT
        }
    if not isinstance(value, list):
        return value
    # Which run compiles kernels is no fact of the result.
    return [
        facts(inner) for inner in value if not str(inner).startswith("kernels are compiled")
    ]


def digest(data: bytes) -> str:
    """Return the digest of some bytes, short enough to be read."""
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def ledger(out: Path) -> Iterator[str]:
    """Yield a line for each file in OUT, for the labels of each cloud, and for each fact of the run."""
    for path in sorted(out.rglob("*")):
        name = path.relative_to(out).as_posix()
        if path.is_dir() or name in LEFT_OUT or name.startswith("store.zarr/"):
            continue
        yield f"{name} {digest(path.read_bytes())}"
        if path.suffix == ".laz":
            yield f"{name} labels {digest(np.asarray(laspy.read(path).classification).astype(np.uint8).tobytes())}"
    for name, value in sorted(facts(json.loads((out / "run.json").read_text())).items()):
        if name not in ("given", "digests", "made_of"):
            yield f"run.json {name} {json.dumps(value, sort_keys=True)}"


def computed(out: Path) -> dict[str, int]:
    """Return the number of tasks that the last run computed, by stage, where there are some."""
    stages = json.loads((out / "run.json").read_text())["stages"]
    return {
        name: stage["computed"] for name, stage in sorted(stages.items()) if stage["computed"]
    }


def resumed(folder: Path, arguments: Arguments) -> None:
    """Run until the terrain is begun, kill the run, and run it again."""
    process = command(folder, "run", *arguments, "-o", "killed", "-q")
    wait_for(folder / "killed", "stage_started", KILLED_IN, process)
    process.kill()
    process.wait()
    do(folder, "run", *arguments, "-o", "killed", "-q")


def main() -> None:
    """Write the ledger to standard output."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.ledger", description=__doc__.split("\n", 1)[0]
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("corpora", nargs="*", default=[make.__name__ for make in CORPORA])
    given = parser.parse_args()
    for make in CORPORA:
        if make.__name__ not in given.corpora:
            continue
        folder = given.folder.resolve() / make.__name__
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        arguments = [*make(folder), "--workers", "2"]
        do(folder, "run", *arguments, "-o", "out", "-q")
        lines = list(ledger(folder / "out"))
        do(folder, "run", *arguments, "-o", "out", "-q")
        again, same = computed(folder / "out"), list(ledger(folder / "out")) == lines
        resumed(folder, arguments)
        killed = set(ledger(folder / "killed")) ^ set(lines)
        print(f"== {make.__name__}", *lines, sep="\n")
        print(
            "second run computes",
            again,
            "and gives the same" if same else "and gives something else",
        )
        print("killed and resumed:", *(sorted(killed) or ["the same"]), sep="\n  ", flush=True)


if __name__ == "__main__":
    main()
