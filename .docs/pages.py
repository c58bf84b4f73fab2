"""Collect the pages of the site: documents of the repository, tutorials, and the reference made of the code."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import reference
from outputs import PICTURE, outputs

# Documents, and what they link to, by the place that they have in the repository.
DOCUMENTS = (
    "README.md", "CONTRIBUTING.md", "LICENSE", "plugins/README.md", "plugins/*/README.md", "examples/*/*.*",
    "examples/*.py", "tests/benchmarks/README.md", "tests/examples/*.py", "tests/third_party/*",
)  # fmt: skip


def collect(root: Path, pages: Path, run: bool = True) -> None:
    """Write all pages of the repository at ``root`` into a folder; ``run`` the tutorials, or show no output."""
    for pattern in DOCUMENTS:
        for path in root.glob(pattern):
            if path.is_file() and path.suffix not in {".pyc"}:
                copy(path, pages / path.relative_to(root))
    for path in (root / ".docs").glob("*.md"):
        text = path.read_text(encoding="utf-8").replace("](../", "](")  # the pages move up beside the README
        (pages / path.name).write_text(text, encoding="utf-8")
    shown = pages / "gallery.md"
    shown.write_text(thumbnails(shown.read_text(encoding="utf-8")), encoding="utf-8")
    tutorials(root / "examples" / "tutorials", pages, run)
    (pages / "reference").mkdir()
    (pages / "reference" / "commands").mkdir()
    for name, text in reference.pages(root / ".docs" / "names.md").items():
        (pages / "reference" / name).write_text(text, encoding="utf-8")
    (pages / "names.md").unlink()
    for path in pages.rglob("*.md"):
        path.write_text(without_lost_links(path), encoding="utf-8")


CARDS = "::::{grid} 1 2 3 3\n:gutter: 3\n\n"
RANKS = "Ranks of the truth"  # how the titles of the figures of calibrations begin


def thumbnails(gallery: str) -> str:
    """Return the gallery with a card for each figure, which leads to the whole one; the ranks of the truth apart."""
    head, *sections = re.split(r"^## ", gallery, flags=re.MULTILINE)
    cards: dict[bool, list[str]] = {False: [], True: []}
    for section in sections:
        title, _, body = section.partition("\n")
        picture = re.search(r"!\[[^\]]*\]\(([^)]+)\)", body)
        if picture is None:
            raise ValueError(f"gallery: {title}: there is no figure")
        text = body.replace(picture[0], "").strip()
        is_rank = title.startswith(RANKS)
        shown, image = title.removeprefix(f"{RANKS}: "), f"[![{title}]({picture[1]})]({picture[1]})"
        card = f":::{{grid-item-card}} {shown[:1].upper()}{shown[1:]}\n{image}\n\n{text}\n:::\n"
        cards[is_rank].append(card)
    figures, ranks = ("\n".join(some) for some in (cards[False], cards[True]))
    return f"{head}{CARDS}{figures}::::\n\n## {RANKS}\n\n{CARDS}{ranks}::::\n"


def copy(path: Path, target: Path) -> None:
    """Copy a file, making its folder."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, target)


def without_lost_links(page: Path) -> str:
    """Return a page in which a link to a folder, or to a file that is not on the site, is text alone.

    The tests of the documents check that each target exists in the repository.
    """
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"\[([^\]\[]*)\]\(([^)#\s]+)\)", lambda link: _kept(link, page), text)
    return text if text.lstrip().startswith(("#", "---", ":::", "(")) else f"# {page.stem}\n\n{text}"


def _kept(link: re.Match[str], page: Path) -> str:
    target = page.parent / link[2]
    return link[0] if link[2].startswith("http") or target.is_file() else link[1]


def tutorials(folder: Path, pages: Path, run: bool = True) -> None:
    """Write a page and a notebook of each tutorial, a script of jupytext with ``# %%`` cells, with what it prints."""
    for path in sorted(folder.glob("*.py")) if folder.is_dir() else []:
        cells = cells_of(path.read_text(encoding="utf-8"))
        (pages / "tutorials").mkdir(exist_ok=True)
        copy(path, pages / "tutorials" / path.name)
        made = outputs(path, cells, pages / "tutorials") if run else []
        found = iter([] if isinstance(made, str) else made)
        shown = [(kind, body, next(found, "") if kind == "code" else "") for kind, body in cells]
        (pages / "tutorials" / f"{path.stem}.ipynb").write_text(json.dumps(notebook(shown)), encoding="utf-8")
        has_pictures = bool(made) and not isinstance(made, str)
        text = "\n\n".join(page_of(each, path.stem, has_pictures) for each in shown)
        head, _, rest = text.partition("\n")
        offer = f"Download: [notebook]({path.stem}.ipynb), [script]({path.name})"
        for table in (each for each in sorted(folder.glob("*.ecsv")) if each.name in path.read_text(encoding="utf-8")):
            copy(table, pages / "tutorials" / table.name)
            offer += f", [its table]({table.name})"
        if isinstance(made, str):
            offer += f". The output is left out: the site was built without the package {made}"
        (pages / "tutorials" / f"{path.stem}.md").write_text(f"{head}\n\n{offer}.\n{rest}\n", encoding="utf-8")


def page_of(cell: tuple[str, str, str], folder: str, has_pictures: bool) -> str:
    """Return a cell of a tutorial as Markdown, with what it prints; ``folder`` has the pictures, if it was run."""
    kind, body, printed = cell
    if kind == "markdown":
        return PICTURE.sub(rf"![\1]({folder}/\2)" if has_pictures else "", body)
    output = f"\n\n```{{code-block}} text\n:class: output\n{printed}\n```" if printed else ""
    return f"```python\n{body}\n```{output}"


def cells_of(text: str) -> list[tuple[str, str]]:
    """Return the cells of a script in jupytext's percent format: ``markdown`` or ``code``, and the text."""
    cells = []
    text = re.sub(r"\A# ---\n.*?^# ---\n", "", text, flags=re.M | re.S)  # jupytext's header
    for part in re.split(r"^# %%", text, flags=re.M):
        head, _, body = part.partition("\n")
        if "[markdown]" in head:
            body = re.sub(r"^# ?", "", body, flags=re.M)
        if body.strip():
            cells.append(("markdown" if "[markdown]" in head else "code", body.strip()))
    return cells


def notebook(cells: list[tuple[str, str, str]]) -> dict[str, object]:
    """Return a notebook of cells, each with what it prints, as nbformat 4 writes it."""
    made = []
    for i, (kind, body, printed) in enumerate(cells):
        cell: dict[str, object] = {"cell_type": kind, "id": f"cell-{i}", "metadata": {}, "source": body}
        if kind == "code":
            stream = {"output_type": "stream", "name": "stdout", "text": f"{printed}\n"}
            cell |= {"execution_count": None, "outputs": [stream] if printed else []}
        made.append(cell)
    return {
        "cells": made,
        "metadata": {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
