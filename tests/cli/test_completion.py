"""What a shell is told when it asks."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from runfiles import RUN

from streamkit.cli.main import main


def completed(*words: str) -> set[str]:
    *before, typed = words
    found = ShellComplete(main, {}, "streamkit", "_STREAMKIT_COMPLETE").get_completions(before, typed)
    return {item.value for item in found}


@pytest.mark.parametrize(
    ("words", "some", "none"),
    [
        (("pl",), {"plugins"}, {"run"}),
        (("plugins", ""), {"potential", "stripping", "observable"}, {"sun"}),
        (("plugins", "potential", "nfw"), {"nfw", "nfw_triaxial"}, {"plummer"}),
        (("reference", "s"), {"sun", "sampler", "stripping"}, {"potential"}),
        (("reference", "progenitor", "plum"), {"plummer"}, {"mlcs"}),
        (("new", "po"), {"potential"}, {"observable"}),
        (("init", "gd"), {"gd1"}, {"sagittarius"}),
        (("run", "small.toml", "--set", "progenitor.r"), {"progenitor.radius="}, {"progenitor.mass="}),
        (("run", "small.toml", "--set", "potential.v0=2"), set(), {"potential.v0="}),
        (("stream", "small.toml", "--set", "potential.v"), {"potential.v0="}, {"potential.v0.uniform="}),
        (("ablate", "small.toml", "--vary", "stripping."), {"stripping.kind="}, {"seed="}),
        (("sensitivity", "small.toml", "--fields", "p"), {"potential.v0", "progenitor.mass"}, {"progenitor.radius"}),
        (
            ("sensitivity", "small.toml", "--fields", "potential.v0,"),
            {"potential.v0,progenitor.mass"},
            {"potential.v0", "potential.v0,potential.v0"},
        ),
        (("run", "nowhere.toml", "--set", "p"), set(), set()),
        (("run", "broken.toml", "--set", "potential.v"), {"potential.v0="}, set()),
    ],
)
def test_completions(run_file: Path, words: tuple[str, ...], some: set[str], none: set[str]) -> None:
    (run_file.parent / "broken.toml").write_text(RUN.replace('kind = "plummer"', 'kind = "plumber"'))
    found = completed(*words)
    assert some <= found
    assert not none & found
    assert found or not some
