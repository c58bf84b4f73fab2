"""If it is written, it runs: the code, run files and commands of the documents."""

import ast
import inspect
import os
import re
import runpy
import shlex
import sys
import tomllib
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import pytest
from commands import call
from documents import (
    CONTRIBUTING,
    DOCUMENTS,
    EXAMPLES,
    LONG,
    MANUAL,
    PLUGINS,
    README,
    RESULTS,
    ROOT,
    STUDIES,
    Block,
    Command,
    blocks,
    commands,
    lay_desk,
    lines,
    reduce_examples,
)
from runfiles import BASE
from snapshots import model_stream, nbody_stream

import streamkit as sk
from streamkit import testing
from streamkit.builtin.observables.apocentres.observable import Apocentres
from streamkit.cli.main import main
from streamkit.components import Component, load_registry
from streamkit.fit.products import products_of
from streamkit.runfile import to_toml
from streamkit.testing.contained import in_a_process

pytestmark = pytest.mark.usefixtures("short_check")
SHELL = ("sh", "console", "")
SHORT = ROOT / "examples" / "pal5" / "README.md"  # the document whose commands run with every commit
DIRECTORY = ROOT / "examples" / "sagittarius" / "README.md"  # it describes the directory of a run
JAFFE = ROOT / "tests" / "third_party" / "streamkit_jaffe.py"
EXAMPLE_TEXTS = {path: path.read_text(encoding="utf-8") for path in EXAMPLES}
MANUAL_BLOCKS = [block for block in blocks("python", MANUAL) if "import check" not in block.text]  # parts of examples
PLAIN_BLOCKS = [block for block in blocks("python") if block not in MANUAL_BLOCKS]
each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


@pytest.fixture(scope="module")
def laid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("desk")
    lay_desk(where)
    return where


@pytest.fixture
def desk(laid: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The desk as working directory, with the examples reduced that the test uses: all of them for a long document."""
    case = request.node.callspec.params if hasattr(request.node, "callspec") else {}
    block = case["block"].text if "block" in case else None
    reduce_examples(laid, SHORT.read_text(encoding="utf-8") if case.get("document") == SHORT else block)
    monkeypatch.chdir(laid)
    return laid


@pytest.fixture(scope="module")
def carried_out() -> set[str]:
    """Commands that were run: several documents show the same one."""
    return set()


def carry_out(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a command of a document in this process."""
    if command.script:
        monkeypatch.setattr(sys, "argv", command.script)
        runpy.run_path(command.script[0], run_name="__main__")
    if command.arguments:
        short = ["3" if option == "--steps" else word for option, word in pairwise(["", *command.arguments])]
        if "--sampler" in short:
            short += ["--set", "sampler.max_calls=100", "--set", "sampler.starts=1"]
        result = call(*short)
        assert result.exit_code == 0, f"{command.words}\n{result.output}"
        assert result.stdout
        if command.target:
            Path(command.target).write_text(result.stdout)
    assert command.script or command.arguments, command.words
    for made in map(Path, command.makes()):  # an imported host of several parts has a table of each: galaxy_halo.ecsv
        assert made.exists() or list(made.parent.glob(f"{made.stem}_*{made.suffix}"))


@each_document
def test_every_command_line_parses(document: Path) -> None:
    for command in commands(document, *SHELL):
        if command.arguments:
            name, *rest = command.arguments
            known = main.get_command(click.Context(main), name)
            assert known is not None, f"{command.block}: {name}"
            known.make_context(name, rest)


@pytest.mark.parametrize(
    "document",
    [
        pytest.param(path, id=str(path.relative_to(ROOT)), marks=() if path == SHORT else pytest.mark.slow)
        for path in [README, *STUDIES, *RESULTS]
    ],
)
def test_the_commands_of_a_document_run_in_their_order(
    document: Path, desk: Path, carried_out: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert commands(document, "console") or document in RESULTS
    for command in commands(document, "console"):
        if shlex.join(command.words) not in carried_out:
            carry_out(command, monkeypatch)
            carried_out.add(shlex.join(command.words))
    if document == README:
        found = {path.name for path in (desk / "out-sagittarius").iterdir() if not path.name.startswith(".")}
        assert found == set(products_of(sk.load(desk / "out-sagittarius" / "run.toml")))
        assert all(f"`{name}`" in DIRECTORY.read_text(encoding="utf-8") for name in found)


def test_every_command_is_shown_where_it_is_run() -> None:
    """Those of a plugin in the plugin's own README, whose tests run them."""
    shown, plugins = (
        {command.arguments[0] for path in paths for command in commands(path, *SHELL) if command.arguments}
        for paths in ([README, *STUDIES, *RESULTS], PLUGINS)
    )
    authors = {command.arguments[0] for command in commands(MANUAL, *SHELL) if command.arguments}
    known = set(main.list_commands(click.Context(main)))
    run = {c.arguments[0] for path in [README, *STUDIES, *RESULTS] for c in commands(path, "console") if c.arguments}
    assert shown <= known
    assert known - run <= plugins | authors


@pytest.mark.parametrize(
    "document", [README, *STUDIES, *RESULTS, *PLUGINS], ids=lambda path: str(path.relative_to(ROOT))
)
def test_what_a_command_needs_exists_or_was_made_by_an_earlier_one(document: Path) -> None:
    made: set[str] = set()
    for command in commands(document, *SHELL):
        if command.arguments or command.script:
            for name in command.reads():
                earlier = {str(path) for path in (Path(name), *Path(name).parents)} & made
                assert earlier or (ROOT / name).exists(), f"{command.block}: {name}"
            made |= command.makes()


@pytest.mark.slow
def test_the_program_of_the_readme_runs(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (shown,) = blocks("python", README)
    exec(compile(shown.text, str(shown), "exec"), {})
    printed = capsys.readouterr().out
    assert "potential.v0" in printed  # the summary
    assert re.search(r"^ *200 ", printed, re.MULTILINE)  # the last radius of the mass profile
    program = [line for line in shown.text.splitlines() if line]
    assert all(re.search(r"  # \d[\d.]* (s|min)\b", line) for line in program)  # and what each one takes


@pytest.mark.parametrize(
    "block",
    [
        pytest.param(block, id=str(block), marks=pytest.mark.slow if any(word in block.text for word in LONG) else ())
        for block in PLAIN_BLOCKS
        if block.document != README
    ],
)
def test_a_python_block_runs(block: Block, desk: Path) -> None:
    exec(compile(block.text, str(block), "exec"), {})


def components_of(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[type[Component]]:
    """Load an example as a plugin file, and return its components."""
    monkeypatch.syspath_prepend(path.parent)
    registry = load_registry([path])
    suppliers = [entry.supplier for kinds in registry.entries.values() for entry in kinds.values()]
    classes: list[type[Component]] = import_module(path.stem).streamkit_components()
    assert len([name for name in suppliers if path.name in name]) == len(classes) == 1
    return classes


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=() if path == JAFFE else pytest.mark.slow) for path in EXAMPLES],
)
def test_an_example_plugin_loads_as_a_file_and_conforms(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for cls in components_of(path, monkeypatch):
        testing.check(cls)


def test_a_plugin_file_works_in_a_second_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba looks for a kernel's module by name when it reads the machine code back from the disk."""
    (tmp_path / "my_potential.py").write_text(EXAMPLE_TEXTS[JAFFE] + "# a file of its own")
    host = {"kind": "jaffe", "mass": 1e12, "a": 80.0}
    document = {"plugins": ["my_potential.py"]} | BASE | {"potential": host}
    (tmp_path / "run.toml").write_text(to_toml(document))
    monkeypatch.chdir(tmp_path)
    first, second = (in_a_process(lambda: [call("stream", "run.toml").stdout])[0] for _ in range(2))
    assert " bound" in first
    assert first.split("CPU time")[0] == second.split("CPU time")[0]


def test_the_manual_shows_how_to_write_each_kind_of_component(monkeypatch: pytest.MonkeyPatch) -> None:
    roles = {cls.role for path in EXAMPLES for cls in components_of(path, monkeypatch)}
    assert roles == {"potential", "stripping", "integrator", "observable", "data", "sampler"}


@pytest.mark.parametrize("block", MANUAL_BLOCKS, ids=str)
def test_the_code_of_the_manual_is_that_of_the_file_above_it(block: Block) -> None:
    """A whole file, or a part of one."""
    above = MANUAL.read_text(encoding="utf-8").splitlines()[block.line - 3]
    linked = re.fullmatch(r"\[`(.*)`\]\(\.\./\1\):", above)
    assert linked is not None, above
    assert block.text in EXAMPLE_TEXTS[ROOT / linked[1]]


def test_every_example_plugin_is_in_the_manual() -> None:
    text = MANUAL.read_text(encoding="utf-8")
    assert all(f"[`{path.relative_to(ROOT)}`](../{path.relative_to(ROOT)}):" in text for path in EXAMPLES)


def test_the_package_shown_is_the_one_that_is_tested() -> None:
    assert (JAFFE.parent / "pyproject.toml").read_text() in [block.text for block in blocks("toml", MANUAL)]
    assert EXAMPLE_TEXTS[JAFFE] in [block.text for block in MANUAL_BLOCKS]


def fragments(document: Path) -> list[tuple[Block, dict[str, Any]]]:
    parsed = [(block, tomllib.loads(block.text)) for block in blocks("toml", document)]
    return [(block, table) for block, table in parsed if "project" not in table]


@each_document
def test_every_part_of_a_run_file_is_valid(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if document in PLUGINS:
        try:
            distribution(document.parent.name)
        except PackageNotFoundError:
            pytest.skip(f"{document.parent.name} is not installed")
    (tmp_path / "my_potential.py").write_text(EXAMPLE_TEXTS[JAFFE])
    for path, text in EXAMPLE_TEXTS.items():
        (tmp_path / path.name).write_text(text)
    monkeypatch.chdir(tmp_path)
    for _, table in fragments(document):
        assert sk.load(BASE | table).names


def test_the_run_file_explained_is_the_example() -> None:
    whole: dict[str, Any] = {}
    for _, table in fragments(README):
        whole |= table
    example = sk.load(ROOT / "examples" / "sagittarius" / "sagittarius.toml").document
    explained = sk.load(whole).document
    assert set(explained) == set(example)
    for section in ("sun", "progenitor", "stripping", "observable", "likelihood"):
        assert explained[section] == example[section], section


def test_the_second_command_line_is_what_ci_runs() -> None:
    first, second, *_ = (lines(block) for block in blocks("sh", README))
    assert len(first) == len(second) == 1
    script = ROOT / ".ci" / "run"
    assert script.read_text().splitlines()[-1] == second[0]
    assert "set -euo pipefail" in script.read_text()
    assert os.access(script, os.X_OK)
    assert "--sampler emulator" in first[0]


def test_the_set_up_names_what_exists() -> None:
    extras = {}
    for project in [ROOT, *(file.parent for file in ROOT.glob("plugins/*/pyproject.toml"))]:
        found = tomllib.loads((project / "pyproject.toml").read_text())["project"]
        extras[project.resolve()] = set(found.get("optional-dependencies", {}))
    for document in DOCUMENTS:
        for command in commands(document, *SHELL):
            words = command.words
            if "install" in words:
                named = [w for w in words[words.index("install") + 1 :] if not w.startswith("-") and "/" in w]
                for word in named:  # others are of an index, or what `streamkit new` has made
                    path, _, extra = word.rstrip("]").partition("[")
                    assert (ROOT / path).resolve() in extras, words
                    assert not extra or extra in extras[(ROOT / path).resolve()], words
            if Path(words[0]).name in ("pytest", "python") and not any("my-" in word for word in words):
                paths = [word for word in words[1:] if "/" in word or word in ("tests", "plugins")]
                assert paths, words
                assert all((ROOT / path).exists() for path in paths), words


def headings(document: Path) -> set[str]:
    """The names by which links call the headings of a document."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@each_document
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", document.read_text(encoding="utf-8")):
        if not target.startswith("https://"):
            path, _, heading = target.partition("#")
            where = document.parent / path if path else document
            assert where.exists(), target
            assert not heading or heading in headings(where), target


def test_the_table_of_the_two_rules_is_what_comes_out() -> None:
    """Within the noise of 10 000 particles (the document's are 20 000)."""
    text = (ROOT / "examples" / "mocks" / "RESULTS.md").read_text(encoding="utf-8")
    streams = {
        "N-body": nbody_stream("B"),
        "mLCS": model_stream("B"),
        "mLCS without the progenitor's gravity": model_stream("B", progenitor_gravity=False),
    }
    for name, stream in streams.items():
        row = re.search(rf"^\| {re.escape(name)} \|(.*)\|$", text, re.MULTILINE)
        assert row is not None, name
        stated = [float(cell.split()[0]) for cell in row[1].split("|")]
        literal = Apocentres(recent_debris="literal").predict(stream).mean
        aware = Apocentres(recent_debris="epoch_aware").predict(stream).mean
        turning = Apocentres(recent_debris="turning").predict(stream).mean
        found = [literal[0], literal[1], aware[1], turning[1], aware[2], turning[2]]
        assert stated == pytest.approx(found, abs=0.06 if name == "N-body" else 1.0), name


def test_every_component_is_in_the_list_that_the_readme_shows() -> None:
    assert any(command.arguments == ["plugins"] for command in commands(README, "console"))
    text = call("plugins").stdout
    for kinds in load_registry().entries.values():
        for kind in kinds:
            assert re.search(rf"^  {kind} ", text, re.MULTILINE), kind


def test_the_manual_names_the_hook_the_bases_and_the_number_types() -> None:
    text = MANUAL.read_text(encoding="utf-8")
    assert "`streamkit_components`" in text
    public = {name: getattr(sk, name) for name in sk.__all__}
    components = [v for v in public.values() if inspect.isclass(v) and issubclass(v, Component)]
    bases = [cls.__name__ for cls in components if cls is not Component]
    numbers = [n for n, v in vars(import_module("streamkit.units")).items() if hasattr(v, "__metadata__")]
    assert len(bases) == 10  # one for each role, `Spherical`, `ChainSampler`, `LiveStripping`, `StrippingScheme`
    assert len(numbers) > 10
    assert set(numbers) <= set(sk.__all__)
    for name in (*bases, *numbers, *testing.__all__[:1]):
        assert re.search(rf"`{name}`", text), name


def test_the_map_is_the_tree() -> None:
    text = CONTRIBUTING.read_text(encoding="utf-8")
    part = text[text.index("## Map") :]
    package = Path(sk.__file__).parent
    folders = {f"{path.parent.relative_to(package)}/" for path in package.glob("*/**/__init__.py")}
    assert set(re.findall(r"^\| `([\w/]+/)`", part, re.MULTILINE)) == folders
    files = {path.name for path in package.glob("*.py")}
    assert set(re.findall(r"`(\w+\.py)`", part)) == files


def documented_constants(module: str) -> set[str]:
    """Names that are assigned in a module with a comment behind or above them; one may stand above several lines."""
    source = inspect.getsource(import_module(module))
    lines, names, above = source.splitlines(), set(), -1
    for statement in ast.parse(source).body:
        if isinstance(statement, ast.Assign):
            first, last = statement.lineno - 1, statement.end_lineno - 1
            if "  # " in lines[last] or lines[first - 1].startswith("# ") or first - 1 == above:
                above = last
                names |= {n.id for t in statement.targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    return names


def test_every_public_name_has_a_docstring() -> None:
    constants = (
        documented_constants("streamkit.units")
        | documented_constants("streamkit.components.hookspecs")
        | documented_constants("streamkit.fields.arrays")
        | documented_constants("streamkit.stream.arrays")
        | documented_constants("streamkit.stream.sky_frames")
    )
    for name in sk.__all__:
        value = getattr(sk, name)
        own = inspect.isclass(value) or inspect.isfunction(value)
        if name == "hookimpl":  # pluggy's own marker
            continue
        assert inspect.getdoc(value) if own else name in constants, name


def test_the_help_of_every_command_names_what_it_does() -> None:
    for name, command in main.commands.items():
        assert command.help, name
        assert call(name, "--help").exit_code == 0
