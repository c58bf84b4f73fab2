"""The site: every public name with an example, every figure, tutorials as pages, and a build without a warning."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote

import pytest
from documents import FENCE, ROOT

from streamkit.cli.main import main
from streamkit.components import ROLES, load_registry

DOCS = ROOT / ".docs"
NAMES = (DOCS / "names.md").read_text(encoding="utf-8")
CODE = "\n".join(match[2] for match in FENCE.finditer(NAMES) if match[1] == "python")
SCRIPT = """# ---
# jupyter:
#   jupytext: {}
# ---

# %% [markdown]
# # My stream
#
# A list:
# - one

# %%
from pathlib import Path

# a comment

# %%
print("one star  ")
Path("sky.png").write_bytes(b"a picture")

# %% [markdown]
# ![The sky](sky.png)
#
# The end.
"""


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(DOCS)
    return import_module("pages")


@pytest.mark.parametrize("module", ["streamkit", "streamkit.engine", "streamkit.testing"])
def test_every_public_name_is_described_and_used(module: str) -> None:
    """Add a new name to one of the lists `<!-- ... -->` of .docs/names.md, and use it in the example above the list."""
    lists = re.findall(r"^<!-- (\S+): (.*?) -->$", NAMES, re.MULTILINE | re.DOTALL)
    listed = [name for door, names in lists if door == module for name in names.replace(",", " ").split()]
    assert sorted(listed) == sorted(import_module(module).__all__)
    if module == "streamkit":
        assert not [name for name in listed if not re.search(rf"\bsk\.{name}\b", CODE)]


def test_every_figure_is_in_the_gallery_beside_the_file_that_makes_it() -> None:
    gallery = (DOCS / "gallery.md").read_text(encoding="utf-8")
    for figure in ROOT.glob("examples/*/*.png"):
        part = gallery.partition(f"](../{figure.relative_to(ROOT)})")[2].partition("\n## ")[0]
        assert re.search(r"\]\(\.\./examples/.*?\.(toml|py)\)", part), figure


def test_the_gallery_has_a_card_for_each_figure_and_the_ranks_apart(pages) -> None:
    source = (DOCS / "gallery.md").read_text(encoding="utf-8")
    made = pages.thumbnails(source)
    figures, _, ranks = made.partition("\n## Ranks of the truth\n")
    pictures = re.findall(r"^!\[", source, re.MULTILINE)
    assert made.count("[![") == made.count(":::{grid-item-card}") == len(pictures)
    assert "Ranks of the truth:" not in re.sub(r"\[!\[.*", "", made)
    assert ranks.count("[![") == source.count("\n## Ranks of the truth:") > 5
    assert figures.count("[![") + ranks.count("[![") == len(pictures)


def test_kinds_have_a_sentence_and_a_field_with_one_value_that_value(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    reference = import_module("reference")
    registry = load_registry()
    page = reference.run_file(registry)
    assert "| [`dop853`](integrator.md#dop853) | " in page
    assert re.search(r"\| `version` \|  \| `1` \| `1` \|", page)
    for role in ROLES:
        rows = reference.kinds(registry, role).splitlines()[2:]
        assert len(rows) == len(registry.entries[role])
        assert all(re.search(r"\) \| \S.{10,}\. \|$", row) for row in rows), rows


def test_the_first_sentence_of_a_description(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    sentence = import_module("reference").sentence
    assert sentence("By Erkal et al. 2019, in\nlines. More.\n\nEnd.") == "By Erkal et al. 2019, in lines."
    assert sentence("One line") == "One line."


def test_each_command_has_a_page_with_its_options_and_an_example(pages) -> None:
    made = import_module("command_pages").pages(ROOT)
    context = main.make_context("streamkit", [], resilient_parsing=True)
    for name in main.list_commands(context):
        page = made[f"commands/{name}.md"]
        assert re.search(rf"^\| \[`{name}`\]\(commands/{name}.md\) \| \S.*\. \|$", made["commands.md"], re.MULTILINE)
        assert f"# streamkit {name}\n" in page
        assert "--help` | Show this message and exit. |" in page
        examples = page.partition("## Examples")[2]
        assert re.search(rf"^\$ .*streamkit {name}( |$)", examples, re.MULTILINE), name


def test_an_example_of_a_command_shows_an_option_that_is_new(pages) -> None:
    chosen, where = import_module("command_pages").chosen, Path("README.md")
    shown = ["streamkit run a.toml", "streamkit run b.toml -o a", "streamkit run b.toml -o b", "streamkit run b.toml"]
    assert chosen([(line, where) for line in shown]) == [(line, where) for line in shown[:2]]


def test_a_tutorial_is_a_page_and_a_notebook_with_what_it_prints_and_draws(tmp_path: Path, pages) -> None:
    folder = tmp_path / "scripts"
    folder.mkdir()
    (folder / "mine.py").write_text(SCRIPT)
    pages.tutorials(folder, tmp_path)
    page = (tmp_path / "tutorials" / "mine.md").read_text()
    assert page.startswith("# My stream\n\nDownload: [notebook](mine.ipynb), [script](mine.py).\n")
    assert "- one\n\n```python\nfrom pathlib import Path\n\n# a comment\n```\n\n```python\nprint" in page
    assert "```\n\n```{code-block} text\n:class: output\none star\n```\n\n![The sky](mine/sky.png)" in page
    assert (tmp_path / "tutorials" / "mine" / "sky.png").read_bytes() == b"a picture"
    assert (tmp_path / "tutorials" / "mine.py").read_text() == SCRIPT
    notebook = json.loads((tmp_path / "tutorials" / "mine.ipynb").read_text())
    assert [cell["cell_type"] for cell in notebook["cells"]] == ["markdown", "code", "code", "markdown"]
    assert [cell.get("outputs") for cell in notebook["cells"][1:3]] == [
        [], [{"output_type": "stream", "name": "stdout", "text": "one star\n"}],
    ]  # fmt: skip
    assert notebook["nbformat"] == 4


def test_a_tutorial_that_is_not_run_shows_no_output(tmp_path: Path, pages) -> None:
    folder = tmp_path / "scripts"
    folder.mkdir()
    (folder / "mine.py").write_text(SCRIPT)
    pages.tutorials(folder, tmp_path, run=False)
    page = (tmp_path / "tutorials" / "mine.md").read_text()
    assert "output" not in page
    assert "![" not in page
    (folder / "mine.py").write_text(SCRIPT.replace("from pathlib", "from no_package.pathlib"))
    pages.tutorials(folder, tmp_path)
    page = (tmp_path / "tutorials" / "mine.md").read_text()
    assert "The output is left out: the site was built without the package no_package.\n" in page
    assert "![" not in page
    (folder / "mine.py").write_text(SCRIPT.replace("# a comment", "1 / 0"))
    with pytest.raises(RuntimeError, match=r"mine.py: it ended with status 1\n(.|\n)*ZeroDivisionError"):
        pages.tutorials(folder, tmp_path)


def test_a_long_output_is_shown_without_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    shortened = import_module("outputs").shortened
    text = "\n".join(str(i) for i in range(100))
    shown = shortened(text).splitlines()
    assert shown == [*(str(i) for i in range(50)), "... 41 more lines", *(str(i) for i in range(91, 100))]


def test_every_tutorial_is_in_the_list() -> None:
    listed = re.findall(r"^tutorials/(\w+)$", (DOCS / "tutorials.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(path.stem for path in ROOT.glob("examples/tutorials/*.py"))


class Links(HTMLParser):
    """The targets of a page's links and pictures, and the names that links may have in it."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.names: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.targets.append(value)
            if value and name in ("id", "name"):
                self.names.add(value)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_its_links_lead_somewhere(tmp_path: Path) -> None:
    pytest.importorskip("sphinx_design", reason="the site needs the extra `docs`")
    resource = pytest.importorskip("resource", reason="Windows does not say how long a process took")
    began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    command = [sys.executable, DOCS / "build.py", tmp_path / "site", "--plain"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began < 120  # seconds of CPU
    pages = (tmp_path / "site").rglob("*.html")
    every = [page for page in pages if "_static" not in page.parts]  # there the theme has templates
    found = {page.resolve(): Links(page) for page in every}
    count = 0
    for page, links in found.items():
        for target in links.targets:
            path, _, name = unquote(target).partition("#")
            if re.match(r"\w+:|//", path):
                continue
            where = (page.parent / path.partition("?")[0]).resolve() if path else page
            assert where.exists(), f"{page}: {target}"
            if name and where in found:
                assert name in found[where].names, f"{page}: {target}"
            count += 1
    assert count > 1000
