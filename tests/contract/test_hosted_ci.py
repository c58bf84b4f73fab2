"""The files for a host in .github: their commands are those of the README, and what they name exists."""

import re
import shlex
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from documents import README, ROOT, blocks, lines

from streamkit.distribution import VERSION

GITHUB = ROOT / ".github"
WORKFLOWS = {path.stem: yaml.safe_load(path.read_text()) for path in sorted(GITHUB.glob("workflows/*.yml"))}
JOBS = {(name, job): steps for name, flow in WORKFLOWS.items() for job, steps in flow["jobs"].items()}
COMMANDS = {
    f"{name} {job} {step.get('name', step['run'])}": step["run"]
    for (name, job), content in JOBS.items()
    for step in content["steps"]
    if "run" in step
}
(SET_UP,) = lines(blocks("sh", README)[1])
TESTS = SET_UP.split("&&")[-1].strip().removeprefix(".venv/bin/")
NO_GALA = {"plugins/streamkit-gala[test]", "plugins/streamkit-spray[test]"}  # spray's tests compare with gala


def editable(command: str) -> set[str]:
    """The packages that a command installs from the clone."""
    words = shlex.split(command)
    return {after for word, after in pairwise(words) if word == "-e"}


INSTALLS = {name: command for name, command in COMMANDS.items() if ".[test]" in editable(command)}


@pytest.mark.parametrize("name", INSTALLS)
def test_the_packages_are_those_of_the_readme(name: str) -> None:
    difference = editable(SET_UP) ^ editable(INSTALLS[name])
    assert difference == (NO_GALA | {"plugins/streamkit-spray"} if "without gala" in name else set())


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if "pytest " in command])
def test_the_tests_are_those_of_the_readme(name: str) -> None:
    assert COMMANDS[name].startswith(TESTS)


def test_one_job_is_the_command_of_the_readme() -> None:
    assert [step.get("run") for step in WORKFLOWS["ci"]["jobs"]["readme"]["steps"]][-1] == ".ci/run"


def test_every_python_that_the_metadata_name_is_tried() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {line.split(" :: ")[-1] for line in project["classifiers"] if re.search(r":: 3\.\d+$", line)}
    matrix = WORKFLOWS["ci"]["jobs"]["tests"]["strategy"]["matrix"]
    assert set(matrix["python"]) == named
    assert len(matrix["os"]) == 3
    assert {row["resolution"] for row in matrix["include"]} == {"lowest-direct"}


@pytest.mark.parametrize("name", COMMANDS)
def test_files_that_a_command_names_exist(name: str) -> None:
    for path in re.findall(r"(?<![\w/])(?:\.ci|plugins|streamkit|\.docs)/[\w./-]*", COMMANDS[name]):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("job", JOBS, ids=" ".join)
def test_a_job_ends_and_may_write_only_where_it_says_so(job: tuple[str, str]) -> None:
    assert JOBS[job]["timeout-minutes"] <= 360  # of the host
    assert WORKFLOWS[job[0]]["permissions"]["contents"] == "read"


def test_the_tag_is_compared_with_the_version() -> None:
    """By sed: the expression of the workflow is applied here."""
    (command,) = (text for text in COMMANDS.values() if "GITHUB_REF_NAME" in text and "VERSION" in text)
    expression = re.search(r"s/\^VERSION = \"\\\(\.\*\\\)\"\$/\\1/p' (\S+)\)", command)
    assert expression is not None
    assert re.findall(r'^VERSION = "(.*)"$', (ROOT / expression[1]).read_text(), re.MULTILINE) == [VERSION]


def test_the_citation_has_the_version() -> None:
    citation = yaml.safe_load((GITHUB / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    assert {"cff-version", "message", "title", "authors"} <= set(citation)  # those that the format requires


@pytest.mark.parametrize("path", sorted(GITHUB.glob("ISSUE_TEMPLATE/*.yml")), ids=lambda path: path.stem)
def test_an_issue_form_has_what_the_host_requires(path: Path) -> None:
    form: dict[str, Any] = yaml.safe_load(path.read_text())
    if path.stem == "config":
        return
    assert {"name", "description", "body"} <= set(form)
    ids = [part["id"] for part in form["body"]]
    assert len(ids) == len(set(ids))
    assert all(part["attributes"]["label"] for part in form["body"])


@pytest.mark.parametrize("path", sorted(GITHUB.glob("*.md")), ids=lambda path: path.stem)
def test_links_of_the_community_files_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", path.read_text()):
        assert target.startswith("https://") or (path.parent / target).exists(), target
