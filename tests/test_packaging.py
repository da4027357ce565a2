"""What is written twice must agree: versions, steps of the image, commands of the README."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

from tiler.version import __version__

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
URLS = PROJECT.get("urls", {})
RECIPE = yaml.safe_load((ROOT / ".ci/conda/recipe.yaml").read_text("utf-8"))
IN_CONDA = {"dask": "dask-core"}
"""Names of packages that conda-forge names otherwise."""
CLOUD = {r.name: r for r in map(Requirement, PROJECT["optional-dependencies"]["cloud"])}
DOCS = {r.name: r for r in map(Requirement, PROJECT["optional-dependencies"]["docs"])}
REQUIREMENTS = {r.name: r for r in map(Requirement, PROJECT["dependencies"])}


def pins(path: str) -> dict[str, Version]:
    """Name -> version of a file of ``name==version`` lines; anything else fails."""
    found = {}
    for line in (ROOT / path).read_text("utf-8").splitlines():
        if line and not line.startswith("#"):
            match = re.fullmatch(r"([A-Za-z0-9_.-]+)==([0-9][A-Za-z0-9.]*)", line)
            assert match is not None, f"{path}: {line!r} is not name==version"
            found[match[1].lower().replace("_", "-")] = Version(match[2])
    return found


@pytest.mark.parametrize(
    "requirement",
    [*REQUIREMENTS.values(), *CLOUD.values(), *DOCS.values()],
    ids=lambda r: r.name,
)
def test_the_lower_bound_is_the_version_that_ci_tests(requirement: Requirement) -> None:
    (bound,) = requirement.specifier
    name = requirement.name
    assert bound.operator == ">="
    assert pins(".ci/lowest.txt")[name] in requirement.specifier
    assert str(pins(".ci/lowest.txt")[name]).startswith(bound.version)


def test_the_image_has_a_fixed_version_of_every_dependency() -> None:
    locked = pins("docker/requirements.lock")
    for name, requirement in REQUIREMENTS.items():
        assert locked[name] in requirement.specifier
    assert "tiler-dtm" not in locked
    build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"][
        "requires"
    ]
    for requirement in map(Requirement, build):
        assert pins("docker/build.lock")[requirement.name] in requirement.specifier


def instructions(name: str) -> list[str]:
    text = (ROOT / "docker/Dockerfile").read_text("utf-8").replace("\\\n", " ")
    return [
        line.removeprefix(name).strip()
        for line in text.splitlines()
        if line.startswith(f"{name} ")
    ]


def test_image_and_smoke_test_run_the_same_scripts() -> None:
    smoke = (ROOT / "docker/smoke.sh").read_text("utf-8")
    runs = instructions("RUN")
    assert [run for run in runs if "install.sh" in run] == ["docker/install.sh /opt/tiler"]
    assert "docker/install.sh " in smoke
    assert any(run.startswith("tiler-check") for run in runs)
    assert "--from=build /src/docker/check.sh /opt/tiler/bin/tiler-check" in instructions(
        "COPY"
    )
    assert "docker/check.sh" in smoke
    assert not [run for run in runs if "pip" in run], "installing is install.sh's alone"


def test_image_is_slim_and_not_root() -> None:
    assert all("python:3.11-slim" in line for line in instructions("FROM"))
    users = instructions("USER")
    assert users == ["tiler"]


@pytest.mark.processes
@pytest.mark.skipif(os.name == "nt", reason="no shell")
def test_smoke_test_takes_the_files_that_the_image_takes() -> None:
    script = "sed -n 's/^COPY \\([^-].*\\) \\/src.*$/\\1/p' docker/Dockerfile | tr ' ' '\\n'"
    assert script in (ROOT / "docker/smoke.sh").read_text("utf-8")
    taken = subprocess.run(
        ["sh", "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert set(taken) == {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "tiler",
        "ptd",
        "cli",
        "docker",
    }
    kept = {
        line[1:]
        for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines()
        if line.startswith("!")
    }
    assert kept == set(taken)


def test_compose_and_smoke_test_start_the_same_cluster() -> None:
    services = yaml.safe_load((ROOT / "docker/compose.yaml").read_text("utf-8"))["services"]
    assert set(services) == {"scheduler", "workers", "run"}
    smoke = (ROOT / "docker/smoke.sh").read_text("utf-8").replace("\\\n", " ")
    for name in ("scheduler", "workers"):
        entry = " ".join(services[name]["entrypoint"])
        local = entry.replace("scheduler:8786", "127.0.0.1:$port").replace(
            "--port 8786", '--host 127.0.0.1 --port "$port"'
        )
        local = re.sub(r"tcp://\S+", lambda m: f'"{m[0]}"', local)
        assert re.sub(r"\s+", " ", local) in re.sub(r"\s+", " ", smoke)
    assert services["run"]["command"][0] == "run"
    assert "--scheduler" in services["run"]["command"]


def test_readme_has_the_two_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text("utf-8").split("## Two commands")[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 2
    assert all(block.count("\n") == 1 for block in blocks), "one command each"
    assert "tiler demo" in blocks[0]
    assert "[test]" in blocks[1]
    assert "pytest" in blocks[1]


def test_the_changelog_knows_this_version() -> None:
    assert f"\n## {__version__} " in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_typed_packages_say_so() -> None:
    for package in ("tiler", "ptd", "cli"):
        assert (ROOT / package / "py.typed").is_file()


def test_the_conda_recipe_asks_for_the_same_versions() -> None:
    python = f"python {PROJECT['requires-python']}"
    lazrs = f"lazrs-python >={pins('.ci/lowest.txt')['lazrs']}"  # the extra of laspy
    wanted = [f"{IN_CONDA.get(name, name)} {r.specifier}" for name, r in REQUIREMENTS.items()]
    assert sorted(RECIPE["requirements"]["run"]) == sorted([python, lazrs, *wanted])
    build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"][
        "requires"
    ]
    backend = [f"{r.name} {r.specifier}" for r in map(Requirement, build)]
    assert sorted(RECIPE["requirements"]["host"]) == sorted([python, "pip", *backend])


def test_the_conda_recipe_makes_one_package_for_all_systems_with_the_same_commands() -> None:
    assert RECIPE["package"] == {"name": PROJECT["name"], "version": __version__}
    assert RECIPE["build"]["noarch"] == "python"
    commands = [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]
    assert RECIPE["build"]["python"]["entry_points"] == commands
    about = RECIPE["about"]
    assert (about["summary"], about["license"]) == (PROJECT["description"], PROJECT["license"])
    assert (ROOT / about["license_file"]).is_file()
    assert (about.get("homepage"), about.get("repository")) == (
        URLS.get("Homepage"),
        URLS.get("Repository"),
    )


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == __version__
    assert citation["license"] == PROJECT["license"]
    assert citation["authors"] == [{"name": author["name"]} for author in PROJECT["authors"]]
    assert citation.get("repository-code") == URLS.get("Repository")
    assert citation.get("url") == URLS.get("Homepage")


def test_ci_tries_each_python_that_the_classifiers_name() -> None:
    script = (ROOT / ".ci/run").read_text("utf-8")
    (others,) = re.findall(r"^ *for version in (.*); do$", script, re.MULTILINE)
    named = [
        c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.", c)
    ]
    assert named == [PROJECT["requires-python"].removeprefix(">="), *others.split()]
