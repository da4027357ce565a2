"""A cluster of processes, an object store that is all that they share, and what can go wrong with both."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cloud import BUCKET, Cable, Cluster, blind
from tests.integration.command import assert_one_line, command, environment, started, tiler
from tests.integration.held import held, hold
from tests.invariants import clouds
from tests.invariants.runs import do, output_digests
from tests.scenes.running import wait_for
from tests.waiting import PATIENCE_SECONDS
from tiler.version import __version__

pytestmark = [pytest.mark.slow, pytest.mark.processes]

OPTIONS = (
    "--method",
    "classic",
    "--resolution",
    1,
    "--tile-size",
    64,
    "--halo",
    80,
    "--memory",
    "1GiB",
)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(128.0, 1.0))


@pytest.fixture(scope="module")
def local(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run of one process."""
    out = tmp_path_factory.mktemp("local") / "out"
    do(cloud, out)
    return out


@pytest.fixture(scope="module")
def bucket(bucket: Any, cloud: Path) -> Any:
    """One that holds the cloud."""
    bucket.put_file(str(cloud), f"{BUCKET}/clouds/city.laz")
    return bucket


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with Cluster(tmp_path) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def two_workers(bucket: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A cluster of two workers, for tests that leave it as it is."""
    with Cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        cluster.workers(2)
        yield cluster


def start(*arguments: object) -> subprocess.Popen[str]:
    return started(command("run", *arguments, *OPTIONS))


def ended(process: subprocess.Popen[str]) -> str:
    """What a run that ends well said."""
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 0, error
    return error


def test_a_worker_is_lost_and_one_joins(
    bucket: Any, cluster: Cluster, cloud: Path, local: Path, tmp_path: Path
) -> None:
    """Workers share nothing with the client but the object store; the bytes are those of one process."""
    first, _ = cluster.workers(2)
    out = tmp_path / "out"
    store = f"s3://{BUCKET}/killed"
    process = start(
        f"s3://{BUCKET}/clouds", "-o", out, "--store", store, "--scheduler", cluster.address
    )
    wait_for(out, "task_done", "filter0", process)
    first.kill()
    cluster.worker()
    ended(process)
    assert output_digests(out) == output_digests(local)
    assert not json.loads((out / "run.json").read_text())["failed_tasks"]


def test_everything_by_url(
    bucket: Any,
    two_workers: Cluster,
    local: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = (
        f"s3://{BUCKET}/clouds/*.laz",
        "-o",
        f"s3://{BUCKET}/town",
        "--scheduler",
        two_workers.address,
    )
    ended(start(*arguments, "--products", "dtm,slope"))
    assert {p.name for p in (tmp_path / "town").iterdir()} == {
        "events.jsonl",
        "report.html",
        "run.json",
    }
    bucket.get(f"{BUCKET}/town/dtm.tif", str(tmp_path / "copy/dtm.tif"))
    bucket.get(f"{BUCKET}/town/classified/", str(tmp_path / "copy/classified/"), recursive=True)
    assert output_digests(tmp_path / "copy") == output_digests(local)
    assert json.loads(bucket.cat(f"{BUCKET}/town/run.json"))["state"] == "done"
    assert (tmp_path / "town/report.html").read_text().count("data:image/png;base64,") == 2
    (tmp_path / "elsewhere").mkdir()
    # what runs from here wrote stands in the run.json of the URL
    monkeypatch.chdir(tmp_path / "elsewhere")
    bucket.rm_file(f"{BUCKET}/town/dtm.tif")
    again = json.loads(tiler("run", *arguments, *OPTIONS, "--json").stdout)["stages"]
    done = {name: stage["computed"] for name, stage in again.items() if stage["computed"]}
    assert done == {"export": 1, "catalogue": 1}
    ended(start(*arguments, "--sheets", "100"))
    sheets = json.loads(bucket.cat(f"{BUCKET}/town/run.json"))["outputs"]
    assert sum(name.startswith("dtm/dtm_") for name in sheets) == 4  # CRS 0 is a corner
    assert all(
        bucket.info(f"{BUCKET}/town/{name}")["size"] == size for name, size in sheets.items()
    )
    assert sorted(bucket.ls(f"{BUCKET}/town/outdated")) == [
        f"{BUCKET}/town/outdated/{name}" for name in ("dtm.tif", "slope.tif")
    ]
    assert not bucket.exists(f"{BUCKET}/town/slope.tif")


def test_the_connection_is_cut(
    cluster: Cluster, cloud: Path, local: Path, tmp_path: Path
) -> None:
    """It is taken up again; a scheduler that is gone ends the run, which goes on without it."""
    cluster.workers(2)
    cable, out = Cable(cluster.port), tmp_path / "out"
    cable.start()
    process = start(cloud, "-o", out, "--scheduler", cable.address)
    wait_for(out, "task_done", "filter0", process)
    cable.cut()
    ended(process)
    assert output_digests(out) == output_digests(local)
    gone = tmp_path / "gone"
    hold(gone)
    process = started(
        held("run", cloud, "-o", gone, "--scheduler", cable.address, "-q", *OPTIONS)
    )
    wait_for(gone, "task_done", "filter0", process)
    cable.cut(for_good=True)
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 4, error
    tiles, *rest = error.splitlines(keepends=True)
    assert tiles.startswith("warning: tiles of 64 m")
    assert_one_line("".join(rest), "the connection broke and was not restored")
    do(cloud, gone)
    assert output_digests(gone) == output_digests(local)


def test_workers_that_see_no_folder_of_the_client(
    bucket: Any,
    two_workers: Cluster,
    local: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The command writes the files itself."""
    monkeypatch.setattr("tiler.schedule.cluster_check.sees", blind)
    out = tmp_path / "out"
    changes = {
        "store": f"s3://{BUCKET}/blind",
        "scheduler": two_workers.address,
        "in_process": False,
    }
    result = do([f"s3://{BUCKET}/clouds"], out, **changes)  # type: ignore[list-item]
    assert any("cannot write into" in note for note in result.summary["notes"])
    assert output_digests(out) == output_digests(local)


def test_the_plan_looks_at_the_workers(
    bucket: Any, two_workers: Cluster, cloud: Path, tmp_path: Path
) -> None:
    """How many there are and what they have, also before there is a store; nothing is left behind."""
    inputs, store = f"s3://{BUCKET}/clouds", f"s3://{BUCKET}/planned"
    options = ("--scheduler", two_workers.address, *OPTIONS)
    done = tiler("plan", inputs, "-o", tmp_path / "out", "--store", store, *options, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    (machine,) = found["cluster"]["machines"]
    assert (machine["workers"], machine["threads"], found["workers"]) == (2, 2, 2)
    assert machine["memory_bytes"] > 1 << 30
    assert found["cluster"]["out_seen"]
    assert not bucket.exists(f"{BUCKET}/planned")
    assert not (tmp_path / "out").exists()
    lines = tiler("plan", inputs, *options).stdout
    assert "2 workers for 2 concurrent tasks on 1 machines" in lines
    done = tiler("plan", inputs, "--store", "s3://nowhere/store", *options)
    assert done.returncode == 2
    assert_one_line(done.stderr, "cannot use s3://nowhere/store", "credentials of the workers")


def test_a_worker_with_another_version(cluster: Cluster, cloud: Path, tmp_path: Path) -> None:
    """A worker process whose tiler says that it is another one: one line, in the plan and before the first task."""
    (tmp_path / "older").mkdir()
    (tmp_path / "older/sitecustomize.py").write_text(
        "import tiler.version\n\ntiler.version.__version__ = '0.0.9'\n"
    )
    root = environment()["PYTHONPATH"]
    cluster.worker(PYTHONPATH=f"{tmp_path / 'older'}:{root}")
    cluster.wait_for(1)
    for arguments in (("plan", cloud), ("run", cloud, "-o", tmp_path / "out", "-q")):
        done = tiler(*arguments, "--scheduler", cluster.address, *OPTIONS)
        assert done.returncode == 2
        assert_one_line(
            done.stderr.splitlines()[-1],
            f"--scheduler {cluster.address}: worker tcp://127.0.0.1:",
            f"has tiler 0.0.9, here {__version__}; install the same versions",
        )
    assert json.loads((tmp_path / "out/run.json").read_text())["state"] == "failed"


def test_workers_without_credentials(bucket: Any, cluster: Cluster, tmp_path: Path) -> None:
    """One line, before the first task."""
    cluster.worker(
        AWS_ACCESS_KEY_ID="", AWS_SECRET_ACCESS_KEY="", AWS_EC2_METADATA_DISABLED="true"
    )
    cluster.wait_for(1)
    places = (
        f"s3://{BUCKET}/clouds",
        "-o",
        tmp_path / "out",
        "--store",
        f"s3://{BUCKET}/denied",
    )
    done = tiler("run", *places, "--scheduler", cluster.address, *OPTIONS, "-q")
    assert done.returncode == 2
    assert_one_line(
        done.stderr.splitlines()[-1], "cannot read s3://", "credentials of the workers"
    )
