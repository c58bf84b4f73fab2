"""The code blocks of the documents, and the desk they run on: example run files that are quick to fit."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import streamkit as sk
from streamkit.runfile import Spec

ROOT = next(folder for folder in Path(__file__).parents if (folder / "pyproject.toml").exists())
README, CONTRIBUTING = ROOT / "README.md", ROOT / "CONTRIBUTING.md"
MANUAL = ROOT / "plugins" / "README.md"  # for authors of plugins
STUDIES = sorted(ROOT.glob("examples/*/README.md"))  # how to use an example
RESULTS = sorted(ROOT.glob("examples/*/RESULTS.md"))  # the results, and the study of the method
PLUGINS = sorted(ROOT.glob("plugins/*/README.md"))
BENCHMARKS = ROOT / "tests" / "benchmarks" / "README.md"
SITE = sorted(ROOT.glob(".docs/*.md"))  # the pages of the site that are no other document
DOCUMENTS = [README, CONTRIBUTING, MANUAL, *STUDIES, *RESULTS, *PLUGINS, BENCHMARKS, *SITE]
# The plugins of the manual: one component a file.
EXAMPLES = [
    ROOT / "tests" / "third_party" / "streamkit_jaffe.py",
    *(path for path in sorted(ROOT.glob("tests/examples/*.py")) if not path.name.startswith("test_")),
]
# What stands in Python blocks that take long: a run, and a host with a body, which compiles for 20 s.
LONG = "sk.run(", "examples/gd1_gap/", "examples/slowing_bar/", "examples/ophiuchus/"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

# Few steps.
NARROW: dict[str, Any] = {
    "sampler.walkers": 6,
    "sampler.steps": 4,
    "sampler.start_particles": 500,
}
NARROW_EMULATOR: dict[str, Any] = {"sampler.max_calls": 20, "sampler.start_particles": 500}
# Errors so wide that every stream fits.
WIDE: dict[str, Any] = {
    "observable.leading": ["48 kpc", "20 kpc"],
    "observable.trailing": ["102 kpc", "40 kpc"],
    "observable.precession": ["93 deg", "40 deg"],
}
# The free parameters, near those of a stream that can be measured.
HOSTS: dict[str, dict[str, Any]] = {
    "sagittarius": {"v0": [235, 245], "rs": [20, 22], "alpha": 0.72},
    "sagittarius_modern": {"v0": [235, 245], "rs": [20, 22], "alpha": 0.72},
    "sagittarius_live": {"v0": [240, 255], "rs": [18, 20], "alpha": 0.75},
    "sagittarius_track": {"v0": [235, 245], "rs": [20, 22], "alpha": 0.72},
    "sagittarius_track_lmc": {"v0": [235, 245], "rs": [20, 22], "alpha": 0.72},
    "sagittarius_lmc": {"halo.mass": [5e11, 6e11]},
    "mock_lmc": {"halo.mass": [5e11, 6e11], "halo.rs": 16.0},
    "mock_alone": {"halo.mass": [5e11, 6e11], "halo.rs": 16.0},
    "mock_tf": {"v0": [205, 215], "rs": [11, 13], "alpha": 0.45},
    "mock_tf_turning": {"v0": [205, 215], "rs": [11, 13], "alpha": 0.45},
    "mock_bulge_disc_halo": {"v0": [231, 241], "rs": [45, 49], "alpha": 0.5},
    "mock_lm10": {"v0": [203, 209], "rs": [25, 29], "alpha": 0.15},
    "track_recovery": {"v0": [235, 245], "alpha": 0.5},
    "gd1": {"v0": [215, 230], "q": 0.9},
    "gd1_stars": {"v0": [215, 230]},
    "gd1_literal": {"v0": [215, 230], "q": 0.9},
    "gd1_recovery": {"v0": [215, 230], "q": 0.9},
    "mock_recovery": {"v0": [205, 215], "alpha": 0.45},
    "pal5": {"halo.mass": [4e11, 5e11], "halo.q": 1.0},
    "pal5_density": {"halo.mass": [4e11, 5e11], "halo.q": 1.0},
    "gd1_pal5": {"halo.mass": [4e11, 5e11], "halo.q": 1.0, "disc.mass": 6.8e10},
    "gd1_pal5_literal": {"halo.mass": [4e11, 5e11], "halo.q": 1.0, "disc.mass": 6.8e10},
    "gd1_pal5_files": {"halo.mass": [4e11, 5e11], "halo.q": 1.0, "disc.mass": 6e10},
    "four_streams": {"halo.mass": [4e11, 5e11], "halo.rs": 16.0, "halo.q": 1.0, "disc.mass": 6.8e10},
    "many_streams": {"halo.mass": [4e11, 5e11], "halo.rs": 16.0, "halo.q": 1.0, "disc.mass": 6.8e10},
    "nonparametric": {"halo.mass_inside": [1.2e11, 1.3e11], "disc.mass": 6.8e10},
    "mock_encounter": {"v0": [215, 230]},
    "atlas_encounter": {"v0": [215, 225]},
    "moving_host": {"halo.orientation.2.values.0": [-120, 120]},
    "slowing_bar": {"bar.pattern_speed.values.0": [-70, -35]},
    "ophiuchus": {"bar.pattern_speed": [-60, -30]},
    "orphan_lmc": {"halo.mass": [4e11, 5e11], "halo.rs": 16.0},
    "orphan_alone": {"halo.mass": [4e11, 5e11], "halo.rs": 16.0},
    "figure5": {"m200": [7e11, 8e11], "c200": [19, 21]},
}


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


@dataclass(frozen=True)
class Command:
    """One command of a shell block: its words, and the file that its output goes to."""

    block: Block
    words: list[str]
    target: str | None = None

    @property
    def arguments(self) -> list[str] | None:
        """The arguments of `streamkit`; None for another program."""
        return self.words[1:] if Path(self.words[0]).name == "streamkit" else None

    @property
    def script(self) -> list[str] | None:
        """A Python script with its arguments; None for another program."""
        runs = Path(self.words[0]).name == "python" and self.words[1].endswith(".py")
        return self.words[1:] if runs else None

    def makes(self) -> set[str]:
        """Return the files and directories that it is told to write."""
        told = {after for word, after in pairwise(self.words) if word in ("-o", "--output", "--plot")}
        return told | ({self.target} if self.target else set())

    def reads(self) -> set[str]:
        """Return the files and directories that it needs."""
        named = {word for word in self.words[1:] if Path(word).suffix in SUFFIXES}
        return (named | ({self.words[2]} if self.words[1] in OF_A_RUN else set())) - self.makes()


OF_A_RUN = ("report", "export", "cite", "status", "host")  # commands that read the directory of a run
SUFFIXES = (".toml", ".npz", ".hdf5", ".py", ".ecsv", ".png")


def lines(block: Block) -> list[str]:
    """Return the command lines of a shell block, without prompts and comments."""
    found = [line.removeprefix("$ ").strip() for line in block.text.splitlines()]
    return [line for line in found if line and not line.startswith("#")]


def commands(document: Path, *languages: str) -> list[Command]:
    """Return the commands of a document's shell blocks, in order."""
    found = []
    for block in sorted((b for language in languages for b in blocks(language, document)), key=lambda b: b.line):
        for part in (part for line in lines(block) for part in line.split("&&")):
            words = shlex.split(part, comments=True)
            target = words[words.index(">") + 1] if ">" in words else None
            found.append(Command(block, words[: words.index(">")] if target else words, target))
    return found


def reduced(path: Path, spec: Spec, particles: int = 500) -> Spec:
    """Return an example with few particles, wide errors and few free parameters."""
    centre = dict(zip(spec.names, spec.centre().tolist(), strict=True))
    host = {
        f"potential.{name}": {"uniform": value} if isinstance(value, list) else value
        for name, value in HOSTS[path.stem].items()
    }
    if path.stem.startswith("sagittarius"):
        host["progenitor.lookback"] = {"uniform": [3.6, 3.8]}
    wide = WIDE if spec.document.get("observable", {}).get("kind") == "apocentres" else {}
    few = {f"{s.path}.particles": particles for s in spec.sections.all if s.path.endswith("stripping")}
    narrow = NARROW_EMULATOR if spec.document["sampler"]["kind"] == "emulator" else NARROW
    return spec.with_values(centre | host | narrow | wide | few)


def lay_desk(where: Path) -> None:
    """Make a directory that looks like the root of the repository."""
    for path in sorted((ROOT / "examples").rglob("*")):
        if path.suffix in (".toml", ".py", ".ecsv", ".ini"):
            copy = where / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    (where / "tests").mkdir()
    (where / "tests" / "data").symlink_to(ROOT / "tests" / "data")


def reduce_examples(where: Path, text: str | None) -> None:
    """Reduce the examples on a desk that a text names, or all of them: each takes a tenth of a second."""
    for path in sorted((ROOT / "examples").rglob("*.toml")):
        copy = where / path.relative_to(ROOT)
        named = text is None or path.name in text
        if named and not path.stem.startswith("truth") and copy.read_bytes() == path.read_bytes():
            spec = sk.load(path)
            if spec.names:
                copy.write_text(reduced(path, spec).toml())
