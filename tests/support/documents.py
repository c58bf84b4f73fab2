"""The code blocks of the documents, and the desk they run on: example run files that are quick to fit."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import streamkit as sk
from streamkit.spec import Spec

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("plugins/*/README.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

NARROW: dict[str, Any] = {
    "sampler.walkers": 10,
    "sampler.steps": 4,
    "observable.leading": ["48 kpc", "20 kpc"],
    "observable.trailing": ["102 kpc", "40 kpc"],
    "observable.precession": ["93 deg", "40 deg"],
}
"""Few steps, and errors so wide that every stream fits."""
HOST = {
    "potential.v0": {"uniform": [235, 245]},
    "potential.rs": {"uniform": [20, 22]},
    "potential.alpha": {"uniform": [0.68, 0.74]},
    "progenitor.lookback": {"uniform": [3.6, 3.8]},
}
MOCK = {
    "potential.v0": {"uniform": [205, 215]},
    "potential.rs": {"uniform": [11, 13]},
    "potential.alpha": {"uniform": [0.43, 0.47]},
}
THREE = {
    "potential.v0": {"uniform": [231, 241]},
    "potential.rs": {"uniform": [45, 49]},
    "potential.alpha": {"uniform": [0.48, 0.52]},
}
LM10 = {
    "potential.v0": {"uniform": [203, 209]},
    "potential.rs": {"uniform": [25, 29]},
    "potential.alpha": {"uniform": [0.13, 0.18]},
}
NFW = {"potential.m200": {"uniform": [7e11, 8e11]}, "potential.c200": {"uniform": [19, 21]}}
"""A few free parameters, near those of a stream that can be measured."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a document."""

    document: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.document.relative_to(ROOT)}:{self.line}"


def blocks(language: str, document: Path | None = None) -> list[Block]:
    """Return the blocks of a language, in order."""
    found = []
    for path in DOCUMENTS if document is None else [document]:
        text = path.read_text(encoding="utf-8")
        for match in FENCE.finditer(text):
            line = text.count("\n", 0, match.start()) + 1
            found.append(Block(path, line, match[1], match[2]))
    return [block for block in found if block.language == language]


def reduced(path: Path, particles: int = 500) -> Spec:
    """Return an example with few particles, wide errors and few free parameters."""
    spec = sk.load(path)
    centre = dict(zip(spec.names, spec.centre().tolist(), strict=True))
    hosts = {"mock_tf": MOCK, "mock_bulge_disc_halo": THREE, "mock_lm10": LM10, "figure5": NFW}
    values = centre | hosts.get(path.stem, HOST) | NARROW
    return spec.with_values(values | {"stripping.particles": particles})


def lay_desk(where: Path) -> None:
    """Make a directory that looks like the root of the repository, its examples reduced."""
    (where / "examples").mkdir()
    for path in sorted((ROOT / "examples").iterdir()):
        if path.suffix == ".toml" and not path.stem.startswith("truth"):
            (where / "examples" / path.name).write_text(reduced(path).toml())
        elif path.is_file():
            shutil.copy(path, where / "examples")
