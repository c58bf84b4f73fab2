"""The distributions: one name, complete metadata, extras for the plugins, files that install without an index."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commands import call, refused
from laid import lay

import streamkit
from streamkit import distribution
from streamkit.components import load_registry, where_to_find
from streamkit.distribution import NAME, foreign_files

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FILES = sorted(ROOT.glob("plugins/*/pyproject.toml"))
PLUGINS = {path.parent.name: tomllib.loads(path.read_text())["project"] for path in FILES}
EXTRAS = PROJECT["optional-dependencies"]
WITHOUT_WHEELS = {"streamkit-agama"}  # AGAMA must be compiled by hand
each_plugin = pytest.mark.parametrize("name", PLUGINS)


def named(requirements: list[str]) -> set[str]:
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in requirements}


def texts() -> list[Path]:
    """The files of the repository in which a command or a requirement may have the name."""
    places = ("README.md", "CONTRIBUTING.md", "streamkit", "plugins", "examples", "tests", ".ci", ".github", ".docs")
    found = [path for place in places for path in [ROOT / place, *(ROOT / place).rglob("*")] if path.is_file()]
    suffixes = {".py", ".md", ".toml", ".txt", ".yml", ".cff", ".sh", ""}
    return [path for path in found if path.suffix in suffixes and "__pycache__" not in path.parts]


def test_the_name_is_the_same_everywhere() -> None:
    assert PROJECT["name"] == NAME
    assert all(NAME in named(project["dependencies"]) for project in PLUGINS.values())
    another = re.compile(r"(?:pip install[^\n]*|[\"'])\bstreamkit(?:\[\w+\]|>=|==)")  # a package of others
    for path in texts():
        for line in path.read_text(encoding="utf-8").splitlines():
            assert not another.search(line.replace(NAME, "")), f"{path}: {line}"


def test_a_new_package_depends_on_it(tmp_path: Path) -> None:
    call("new", "potential", "mine", "-o", tmp_path / "mine")
    assert tomllib.loads((tmp_path / "mine" / "pyproject.toml").read_text())["project"]["dependencies"] == [NAME]


def test_the_extras_bring_the_plugins() -> None:
    assert named(EXTRAS["all"]) == set(PLUGINS) - WITHOUT_WHEELS
    for plugin, project in PLUGINS.items():
        (requirement,) = EXTRAS[plugin.removeprefix("streamkit-")]
        assert requirement.split(">=")[0] == plugin
        assert project["version"].startswith(requirement.split(">=")[1])
        for name in (name for group in project["entry-points"].values() for name in group):
            assert EXTRAS[name.replace("_", "-")] == [requirement]
            assert f" is in {plugin}: " in where_to_find(name), "old metadata are installed: pip install -e ."
    assert not named(EXTRAS["test"]) & set(PLUGINS)  # the test command takes them from the clone


@pytest.mark.parametrize("project", [PROJECT, *PLUGINS.values()], ids=lambda project: project["name"])
def test_the_metadata_are_complete(project: dict[str, object]) -> None:
    texts = {"description", "readme", "requires-python", "license", "license-files", "authors", "keywords"}
    assert texts | {"classifiers"} <= set(project)
    assert project["requires-python"] == PROJECT["requires-python"]
    assert project["license"] == PROJECT["license"]


@each_plugin
def test_a_plugin_has_the_licence(name: str) -> None:
    assert (ROOT / "plugins" / name / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


def test_there_is_one_version() -> None:
    assert PROJECT["dynamic"] == ["version"]
    assert streamkit.__version__ == distribution.VERSION
    assert call("--version").stdout == f"streamkit {distribution.VERSION}\n"


OURS = "[streamkit]\nbuiltin = streamkit.builtin\n"
FOREIGN = "[console_scripts]\nstreamkit = streamkit.cli:main\n"


@pytest.mark.parametrize(
    ("installed", "whose"),
    [
        ([(NAME, OURS)], ""),
        ([("streamkit", OURS)], ""),  # before the name, and nothing else
        ([(NAME, OURS), ("streamkit", FOREIGN)], "a package of another project"),
        ([("streamkit", FOREIGN)], "a package of another project"),  # our files run from a clone
        ([(NAME, OURS), ("streamkit", OURS)], "an older install of this package"),
    ],
)
def test_another_distribution_in_the_folder_is_recognised(
    installed: list[tuple[str, str]], whose: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, points in installed:
        lay(tmp_path, name, points, "0.3.2")
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    sentence = foreign_files()
    assert whose in sentence
    assert bool(sentence) == bool(whose)


@pytest.mark.parametrize("arguments", [["--version"], ["plugins"], pytest.param(["schema"], marks=pytest.mark.slow)])
def test_every_command_reports_a_foreign_distribution(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay(tmp_path, NAME, OURS, "0.1")
    lay(tmp_path, "streamkit", FOREIGN, "0.3.2")
    monkeypatch.syspath_prepend(tmp_path)
    expected = (
        "streamkit: The distribution 'streamkit' 0.3.2 is installed too, a package of another project that writes "
        "files into the same folder. Remove both, then install this one again: "
        f"pip uninstall streamkit {NAME}, pip install {NAME}.\n"
    )
    done = call(*arguments)
    assert (done.exit_code, done.stderr) == (0, expected)
    assert refused("check", "none.toml").endswith(expected)


def test_a_module_of_another_project_ends_in_the_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its files took the place of ours: here, `streamkit.load` is gone."""
    (tmp_path / "run.toml").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delattr(streamkit, "load", raising=False)
    monkeypatch.delattr(streamkit, "__getattr__")
    with pytest.raises(AttributeError):  # without another distribution it is a fault of ours, and is shown
        call("check", tmp_path / "run.toml")
    lay(tmp_path, NAME, OURS, "0.1")
    lay(tmp_path, "streamkit", FOREIGN, "0.3.2")
    assert refused("check", tmp_path / "run.toml").startswith("streamkit: The distribution 'streamkit' 0.3.2 is ")


def test_components_of_two_installs_are_loaded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of both names have one digest: the supplier of a built-in component is called by the package."""
    before = load_registry()
    for name in ("streamkit-of-old", "streamkit-of-late"):
        lay(tmp_path, name, OURS, "7")
    monkeypatch.syspath_prepend(tmp_path)
    registry = load_registry()
    assert registry.failed == before.failed
    assert registry.entries["potential"]["plummer"].supplier == f"streamkit {streamkit.__version__}"


@pytest.mark.slow
def test_wheels_from_sdists_install_without_an_index(tmp_path: Path) -> None:
    """All packages into an empty folder, tried outside the clone; what they need is that of the tests."""

    def run(*command: str | Path, cwd: Path, **environment: str) -> str:
        words = [sys.executable, *map(str, command)]
        done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, env={**os.environ, **environment})
        assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    dist, site = tmp_path / "dist", tmp_path / "site"
    for project in [ROOT, *(ROOT / "plugins" / name for name in PLUGINS)]:
        run("-m", "hatchling", "build", "-t", "sdist", "-d", dist, cwd=project)
    pip = ("-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation")
    for sdist in sorted(dist.glob("*.tar.gz")):
        run(*pip, "--target", site, sdist, cwd=tmp_path)
    environment = {"PYTHONPATH": str(site)}
    where = run("-c", "import streamkit; print(streamkit.__file__)", cwd=tmp_path, **environment)
    assert Path(where.strip()).is_relative_to(site)
    listing = run("-m", "streamkit", "plugins", cwd=tmp_path, **environment)
    assert all(f"{name} 0.1" in listing for name, project in PLUGINS.items() if "streamkit" in project["entry-points"])
    run("-m", "streamkit", "init", "gd1", cwd=tmp_path, **environment)
    assert "observables" in run("-m", "streamkit", "check", "gd1.toml", "--draws", "0", cwd=tmp_path, **environment)
