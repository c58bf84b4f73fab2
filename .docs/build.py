"""Build the site: ``python .docs/build.py [FOLDER] [--plain]``, default ``site``.

It needs ``pip install -e ".[docs]"``. The tutorials are run, and their pages show what they
print: five minutes of one core. ``--plain`` leaves this out.

The pages are the documents of the repository, where they are, those of this folder, and the reference, which is made
of the installed components, of the commands and of the docstrings. A warning is an error.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from pages import collect


def build(folder: Path, run: bool = True) -> int:
    """Build the site in a folder, and return the exit status of Sphinx; ``run`` the tutorials for their output."""
    from sphinx.cmd.build import main

    here = Path(__file__).resolve().parent
    with tempfile.TemporaryDirectory() as pages:
        collect(here.parent, Path(pages), run)
        words = ["-W", "--keep-going", "-q", "-j", "auto", "-b", "html", "-c", str(here)]
        return main([*words, "-d", f"{pages}-cache", pages, str(folder)])


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--plain"]
    sys.exit(build(Path(words[0] if words else "site"), run="--plain" not in sys.argv))
