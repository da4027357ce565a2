"""Many small files, and many buckets: open files, memory of the command, seconds.

    python tests/benchmarks/many_files.py files FOLDER 5000 --workers 2
    python tests/benchmarks/many_files.py buckets 100000

`files` makes a folder of files of 2,000 points side by side, runs the whole job on it as a command and looks at its
process ten times a second. `buckets` has no points: it makes what the finished ingest of so many buckets tells, and
times what the command does with it: cutting tiles, listing the tasks of each stage with their digests, and a
worker's look at the index.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import psutil
from pyproj import CRS

SIDE_M, POINTS = 40.0, 2000
PAUSE = 0.1


def make_files(folder: Path, number: int) -> None:
    """Files of `POINTS` points on a plain, side by side."""
    folder.mkdir(parents=True, exist_ok=True)
    across = int(np.ceil(np.sqrt(number)))
    random = np.random.default_rng(1)
    for i in range(number):
        path = folder / f"{i:06d}.laz"
        if path.exists():
            continue
        x, y = random.random((2, POINTS)) * SIDE_M
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.offsets = [
            500_000 + SIDE_M * (i % across),
            5_000_000 + SIDE_M * (i // across),
            0,
        ]
        header.scales = [0.01] * 3
        header.add_crs(CRS.from_epsg(25832))
        las = laspy.LasData(header)
        las.x, las.y = x + header.offsets[0], y + header.offsets[1]
        las.z = 100 + 0.02 * x + random.random(POINTS) * 0.02
        las.return_number[:] = 1
        las.number_of_returns[:] = 1
        las.classification[:] = 2
        las.write(path)


def run_files(folder: Path, number: int, workers: int, *options: str) -> dict[str, Any]:
    """Seconds, and what the command's own process held at most."""
    make_files(folder / "in", number)
    out = folder / "out"
    places = ["run", str(folder / "in"), "-o", str(out), "--workers", str(workers)]
    command = [sys.executable, "-m", "cli.main", *places, *options]
    start = time.monotonic()
    with open(folder / "log.txt", "w", encoding="utf-8") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ})
        look, memory, files, workers_files, cpu = psutil.Process(process.pid), 0, 0, 0, 0.0
        while process.poll() is None:
            try:
                memory, files = max(memory, look.memory_info().rss), max(files, look.num_fds())
                cpu = look.cpu_times().user + look.cpu_times().system
                children = look.children(recursive=True)
                workers_files = max([workers_files, *(child.num_fds() for child in children)])
            except psutil.Error:
                pass
            time.sleep(PAUSE)
    seconds = time.monotonic() - start
    summary = json.loads((out / "run.json").read_text())
    return {
        "files": number,
        "code": process.returncode,
        "seconds": round(seconds, 1),
        "seconds_per_1000_files": round(seconds / number * 1000, 1),
        "command_cpu_seconds": round(cpu, 1),
        "command_rss_mb": round(memory / 1e6),
        "command_open_files": files,
        "worker_open_files": workers_files,
        "stages": {name: [s["tasks"], s["seconds"]] for name, s in summary["stages"].items()},
    }


def simulate_buckets(number: int, memory: bool = False) -> dict[str, Any]:
    """What the command does of a run of many buckets but wait for its workers; or its memory, as tracing takes time."""
    from dataclasses import replace
    from fractions import Fraction
    from tempfile import TemporaryDirectory

    from tests.scenes.records import bucket_record, spool_record
    from tiler.config import RunConfig
    from tiler.core.lattice import Bounds, Cell
    from tiler.export.tasks.files import cog_tasks, inputs_of, mosaic_tasks
    from tiler.export.tasks.sheets import sheets, with_points
    from tiler.filter.tasks.passes import PassInputs, filter_tasks, label_digests
    from tiler.grid.tasks.gridding import GridContext
    from tiler.grid.tasks.raster_table import required_rasters
    from tiler.plan import make_plan
    from tiler.runs.found import IngestResult, Source
    from tiler.store import BucketInfo, create_store

    facts: dict[str, Any] = {"buckets": number}

    def timed(name: str, work: Any) -> Any:
        start = time.monotonic()
        result = work()
        facts[name] = round(time.monotonic() - start, 2)
        return result

    with TemporaryDirectory() as scratch:
        make_files(Path(scratch) / "in", 1)
        config = RunConfig.from_mapping(
            {"products": ["dtm", "hillshade", "density"], "sheets": "1000", "water": "none"}
        )
        plan = make_plan([str(Path(scratch) / "in")], config)
        side = int(np.ceil(np.sqrt(number)))
        west, south = (int(plan.buckets.index_of(v)) for v in plan.inputs.extent.to_json()[:2])
        cells = [Cell(west + i % side, south + i // side) for i in range(number)]
        plan = replace(plan, method=replace(plan.method, tile=Fraction(512)))
        lattice = plan.buckets
        if memory:
            tracemalloc.start()
        counts = {"n": 100_000, "n_candidates": 40_000}
        records = {
            c: bucket_record(cell=[c.ix, c.iy], bounds=lattice.bounds(c).to_json(), **counts)
            for c in cells
        }
        assembled = IngestResult(records, {c: f"{i:032x}" for i, c in enumerate(cells)})
        store = create_store(str(Path(scratch) / "store.zarr"), plan.grid.meta)

        def publish() -> None:
            store.allocate(dict.fromkeys(cells, 100_000))
            store.publish_index({c: BucketInfo(100_000, 40_000) for c in cells})

        timed("allocate_and_publish", publish)
        tasks = timed(
            "filter_tasks",
            lambda: list(filter_tasks(plan, assembled, 0, {}, PassInputs(assembled.digests))),
        )
        facts["tiles"] = len(tasks)
        labels = timed("label_digests", lambda: label_digests(assembled, {}))
        g = GridContext(plan, assembled, labels)
        sides = {side: [[0, 512]] for side in ("north", "south", "west", "east")}
        found = {
            "filled": 1,
            "water": 0,
            "sides": sides,
            "labels": 0,
            "inside": 1,
            "blocks": [],
        }
        for raster in required_rasters(plan):
            made = timed(f"tasks_{raster.name}", lambda raster=raster: list(raster.tasks(g)))
            g.fills[raster.name] = raster.fill
            g.made[raster.name] = {
                t.key: (t.digest, {"checksum": t.digest, **found}) for t in made
            }
        facts["blocks"] = len(g.made["dtm"])
        spooled = {
            f"s{i:06d}-{0:012d}": (
                "",
                spool_record(
                    buckets=[[c.ix, c.iy, 1] for c in cells[i * 20 : i * 20 + 20]]
                ).to_json(),
            )
            for i in range(number // 20)
        }
        sources = [Source(plan.inputs.sources[0], i, f"{i:032x}") for i in range(number // 20)]
        inputs = inputs_of(sources, spooled)
        gridded = g.found()
        cut = timed("sheets", lambda: sheets(gridded, with_points(gridded)))
        gridded = replace(gridded, sheets=cut)
        facts["sheets"] = len(
            timed("tasks_sheets", lambda: list(cog_tasks(gridded, inputs, "x", scratch)))
        )
        timed("tasks_vrt", lambda: list(mosaic_tasks(gridded, "x", scratch)))
        if memory:
            return {"tables_and_tasks_mb": round(tracemalloc.get_traced_memory()[1] / 1e6)}
        bounds = lattice.bounds(cells[number // 2])
        window = Bounds(*bounds.to_json()).pad(300_000)
        store.buckets_within(window)
        start = time.monotonic()
        for _ in range(100):
            store.buckets_within(window)
        facts["ms_of_a_window"] = round((time.monotonic() - start) * 10, 2)
        timed("all_buckets", store.buckets)
    return facts


def main() -> None:
    """Print facts as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("files", "buckets"))
    parser.add_argument("arguments", nargs="*")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--option", action="append", default=[])
    settings = parser.parse_args()
    if settings.what == "files":
        folder, number = settings.arguments
        found = run_files(Path(folder), int(number), settings.workers, *settings.option)
    else:
        number = int(settings.arguments[0])
        found = simulate_buckets(number)
        found |= simulate_buckets(number, memory=True)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
