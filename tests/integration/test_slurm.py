"""The recipe for SLURM in `docs/cluster.md`, with an ``sbatch`` that starts each job on this machine."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

from tests.integration.command import ROOT, command, ended, environment
from tests.invariants import clouds
from tests.invariants.runs import output_digests

pytestmark = pytest.mark.slow

SBATCH = """#!/bin/sh
cp "$1" "$JOBS/job"
setsid sh "$JOBS/job" >"$JOBS/log" 2>&1 &
echo $! >>"$JOBS/pids"
echo Submitted batch job $!
"""
SCANCEL = """#!/bin/sh
kill -- "-$1"
"""
HERE = (
    ("cores=8", "cores=2"),
    ("processes=8", "processes=2"),
    ('memory="32GB"', 'memory="4GB"'),
    ("jobs=10", "jobs=1"),
    ('"/project/clouds"', "CLOUDS"),
    ('"/project/terrain"', 'OUT, "--method", "classic", "--tile-size", "64", "--halo", "80"'),
    ('"tiler"', 'sys.executable, "-m", "cli.main"'),
)
"""What is another on a small machine."""


def recipe(cloud: Path, out: Path) -> str:
    """The file of the page, for this machine."""
    text = (ROOT / "docs/cluster.md").read_text("utf-8").split("## SLURM")[1]
    found = re.search(r"```python on-a-cluster\n(.*?)```", text, re.DOTALL)
    assert found is not None
    made = found[1]
    for there, here in HERE:
        assert made.count(there) == 1, there
        made = made.replace(there, here)
    return made.replace("CLOUDS", repr(str(cloud))).replace("OUT", repr(str(out)))


@pytest.mark.processes
def test_the_recipe_gives_the_bytes_of_one_machine(tmp_path: Path) -> None:
    programs, jobs, out = tmp_path / "bin", tmp_path / "jobs", tmp_path / "out"
    for folder in (programs, jobs):
        folder.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    cloud = clouds.write(tmp_path / "city.laz", clouds.city(150.0, 1.0))
    (tmp_path / "cluster.py").write_text(recipe(cloud, out))
    own = {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "JOBS": str(jobs),
        "DASK_JOBQUEUE__SLURM__SCHEDULER_OPTIONS": '{"host": "127.0.0.1", "dashboard": False}',
    }
    done = ended(
        [sys.executable, tmp_path / "cluster.py"], cwd=tmp_path, env={**environment(), **own}
    )
    log = (jobs / "log").read_text("utf-8")
    assert done.returncode == 0, done.stdout + done.stderr + log
    job = (jobs / "job").read_text("utf-8")
    for line in ("#SBATCH --cpus-per-task=2", "#SBATCH --mem=4G", "#SBATCH -t 04:00:00"):
        assert line in job
    assert job.index("export PYTHONSAFEPATH=1") < job.index("--nthreads 1")
    assert "--nworkers 2" in job
    assert job.rindex("--memory-limit") == job.rindex("--memory-limit 0"), "the last one counts"
    plain = tmp_path / "plain"
    options = ("--method", "classic", "--tile-size", 64, "--halo", 80, "--memory", "1GiB")
    assert ended(command("run", cloud, "-o", plain, *options)).returncode == 0
    assert output_digests(out) == output_digests(plain)
    for pid in (jobs / "pids").read_text("utf-8").split():
        assert not Path("/proc", pid).exists(), "the end of the command ends the jobs"
