"""The reader's path: some forty files that carry a run file to a posterior, and what they take from other files."""

import ast
import re
from pathlib import Path

import streamkit

PACKAGE = Path(streamkit.__file__).parent
PAGE = (PACKAGE.parent / ".docs" / "reading.md").read_text(encoding="utf-8")
LISTED, GRANTED = PAGE.split("## Taken for granted")
ENTRY = r"^(\d+)\. \[(.+?)\]\(\.\./streamkit/(.+?)\): (.+?)(?=\n\n|\n\d+\. )"  # number, text, target, sentence
FILES = re.findall(ENTRY, LISTED, re.MULTILINE | re.DOTALL)
PATH = [place for _, _, place, _ in FILES]
ROWS = re.findall(r"^\| (`.+?) \| (.+?) \|$", GRANTED, re.MULTILINE)
KNOWN = [file for files, _ in ROWS for file in re.findall(r"`(.+?)`", files)]

MOST_LINES = 5000


def source_of(module, name):
    """The file that defines a name of a module or a door; the door itself for a package."""
    place = PACKAGE.parent.joinpath(*module.split("."))
    if place.with_suffix(".py").is_file():
        return place.with_suffix(".py")
    stub = place / "__init__.pyi"
    door = stub if stub.is_file() else place / "__init__.py"
    for node in ast.parse(door.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and name in {alias.asname or alias.name for alias in node.names}:
            return source_of(".".join(filter(None, (module if node.level else "", node.module))), name)
    inner = place / f"{name}.py"
    return inner if inner.is_file() else place / name if (place / name).is_dir() else place / "__init__.py"


def sources(file):
    """All files of streamkit whose names a file imports at its top, or uses of a package that it imports whole."""
    tree, found = ast.parse((PACKAGE / file).read_text(encoding="utf-8")), set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or not node.module or not node.module.startswith("streamkit"):
            continue
        for alias in node.names:
            source = source_of(node.module, alias.name)
            if source.is_dir():  # a package as a whole: what is used of it
                name, inner = alias.asname or alias.name, f"{node.module}.{alias.name}"
                used = [each for each in ast.walk(tree) if isinstance(each, ast.Attribute)]
                found |= {source_of(inner, each.attr) for each in used if getattr(each.value, "id", None) == name}
            else:
                found.add(source)
    return {each.relative_to(PACKAGE).as_posix() for each in found}


def test_the_path_is_short():
    assert 20 <= len(PATH) <= 40
    assert sum(len((PACKAGE / file).read_text(encoding="utf-8").splitlines()) for file in PATH) <= MOST_LINES


def test_each_file_is_listed_once_with_a_sentence():
    assert [int(number) for number, *_ in FILES] == list(range(1, len(PATH) + 1))
    assert len(re.findall(r"^\d+\. ", LISTED, re.MULTILINE)) == len(PATH)
    assert len({*PATH, *KNOWN}) == len(PATH) + len(KNOWN)
    for _, shown, place, sentence in FILES:
        assert shown == place
        assert sentence.endswith(".")
        assert ". " not in " ".join(sentence.split()), f"{place}: more than one sentence"
    assert all(words.strip() for _, words in ROWS)


def test_a_file_stands_after_those_that_it_uses():
    for i, file in enumerate(PATH):
        later = sources(file) & set(PATH[i + 1 :])
        assert not later, f"{file} uses {later}, which the reader has not seen"


def test_nothing_else_is_needed():
    """Every other file that a file of the path takes a name from is explained in a few words, and no more of them."""
    used = set().union(*(sources(file) for file in PATH))
    assert used - set(PATH) - set(KNOWN) == set(), "add it to the path, or to what is taken for granted"
    assert set(KNOWN) - used == set(), "no file of the path uses it"
