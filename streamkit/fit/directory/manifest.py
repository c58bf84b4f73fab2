"""The manifest of a run: a record in its directory that identifies the run and the versions it was made with."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from streamkit.distribution import VERSION
from streamkit.errors import ChainError, brief, expect_file, printable
from streamkit.runfile import Spec

MANIFEST = "manifest.json"
PACKAGES = "numpy", "scipy", "numba", "emcee", "astropy"
MOST_STEPS = 10**12  # a longer chain is no chain: keeps the arithmetic of times within floating-point numbers

# A manifest may come from elsewhere, and its texts are shown on terminals.
Text = Annotated[str, AfterValidator(printable)]


class _Options(BaseModel):
    """The options of the command, or the call, that began or resumed the run."""

    model_config = ConfigDict(strict=True)

    quick: bool = False
    steps: int | None = Field(default=None, ge=1, le=MOST_STEPS)
    arguments: list[Text] = []
    launcher: list[Text] = ["streamkit"]
    given: list[Text] = []


class _Manifest(BaseModel):
    """All that is read of a manifest; an entry that is not named here is left alone."""

    model_config = ConfigDict(strict=True)

    digest: Text
    run_file: Text = ""
    seed: int = Field(default=0, ge=0)
    versions: dict[Text, Text] = {}
    files: dict[Text, Text] = {}
    components: dict[Text, Text] = {}
    limits: dict[Text, Any] | None = None  # None in a manifest of a former version
    options: _Options = _Options()


def manifest_of(spec: Spec, options: dict[str, Any], run_file: bytes) -> dict[str, Any]:
    """Return the manifest of a run, with the options of its command and the content of its resolved run file."""
    return {
        "digest": spec.digest(),
        "run_file": hashlib.sha256(run_file).hexdigest(),
        "seed": spec.seed,
        "versions": {"python": platform.python_version(), "streamkit": VERSION} | {n: version(n) for n in PACKAGES},
        "files": dict(spec.files),
        "components": {path: f"{cls.kind} from {supplier}" for path, cls, supplier in spec.components()},
        "limits": {name: value for name, value in spec.document["sampler"].items() if name in spec.sampler.stopping},
        "options": options,
    }


def manifest(directory: Path) -> dict[str, Any]:
    """Read the manifest of a run, without control characters; ChainError if there is none, or it is not readable."""
    path = directory / MANIFEST
    if not directory.is_dir():
        what = "is a file, expected the directory of a run" if directory.exists() else "there is no such directory"
        raise ChainError(f"{directory}: {what}")
    try:
        expect_file(path)
        content = json.loads(path.read_bytes().decode())
    except FileNotFoundError:
        raise ChainError(f"{directory}: holds no run: it has no {MANIFEST}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise ChainError(f"{directory}: no streamkit run: {MANIFEST} is not readable ({error})") from None
    try:
        return _Manifest.model_validate(content).model_dump()
    except ValidationError as error:
        raise ChainError(f"{path}: not the manifest of a streamkit run ({brief(error)})") from None
