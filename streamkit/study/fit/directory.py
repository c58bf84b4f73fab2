"""The output directory: whose it is, what may be written into it, and each product whole or not at all."""

from __future__ import annotations

import json
import platform
import shlex
import shutil
import tomllib
from collections import Counter
from collections.abc import Collection
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from streamkit.components import is_loaded, with_neighbours
from streamkit.errors import ChainError
from streamkit.report import contents, replace_whole, safely
from streamkit.runfile import DEFAULT_KIND, ONLY, Spec, differences, to_toml
from streamkit.sample import CALLS, CHAIN, JOURNAL, SAMPLES, Chain, Weighted, read_chain_file, read_weighted

RUN_FILE = "run.toml"
MANIFEST = "manifest.json"
# Folder with copies of the run's plugin files, and of the files that these import from beside them.
PLUGIN_COPIES = "plugins"
DATA_COPIES = "data"  # folder with copies of the run's data files
RECOVERY = ("recovery.ecsv", "recovery.png")  # what a report beside the truth adds
LITERATURE = "literature.ecsv"  # published values that a report was given, kept for the next one


def claim(
    directory: Path, spec: Spec, options: dict[str, Any], products: Collection[str], resume: bool, force: bool
) -> bool:
    """Make the directory this run's own; return whether there is a chain to continue.

    Parameters
    ----------
    directory
        It exists, and is `locked`.
    spec
        The run.
    options
        Command options for the manifest.
    products
        Every file that a run or a report may write there.
    resume, force
        Continue the same run; overwrite the products of another one.

    Raises ChainError if it holds something that must not be touched; says what. Nothing has then been changed.
    """
    if resume and force:
        raise ChainError("resume and force exclude each other: continue the chain, or throw it away?")
    files = contents(directory)
    going_on = False
    if files and resume:
        going_on = _same_run(directory, spec, files)
    elif files and force:
        _only_ours(directory, files, products)
        for name in products:
            if name != MANIFEST:  # it says whose the directory is, until the new one takes its place
                (directory / name).unlink(missing_ok=True)
    elif files:
        raise ChainError(_occupied(directory, files))
    manifest = json.dumps(_manifest(spec, options), indent=2) + "\n"
    with safely(directory / MANIFEST):
        replace_whole(directory / MANIFEST, lambda part: part.write_text(manifest))
    if not going_on:
        _write_run_file(directory, spec, options)
    return going_on


def _write_run_file(directory: Path, spec: Spec, options: dict[str, Any]) -> None:
    """Write the resolved run file, with copies of its plugins and data files: the directory can be read anywhere."""
    places = _copies(spec)
    document = spec.with_files_at(places)
    sources = [spec.folder / name for name in spec.document.get("plugins", [])]
    copies = {Path(place): spec.folder / name for name, place in places.items()}
    for source in sources:
        copies |= {PLUGIN_COPIES / file.relative_to(source.parent): file for file in with_neighbours(source)}
    for place, file in copies.items():
        with safely(directory / place):
            (directory / place).parent.mkdir(parents=True, exist_ok=True)
            replace_whole(directory / place, partial(shutil.copyfile, file))
    if sources:
        document["plugins"] = [f"{PLUGIN_COPIES}/{source.name}" for source in sources]
    components = [f"{path}: {cls.kind} ({supplier})" for path, cls, supplier in spec.components()]
    text = to_toml(document, "\n".join([header(options), *components]))
    with safely(directory / RUN_FILE):
        replace_whole(directory / RUN_FILE, lambda part: part.write_text(text))


def _copies(spec: Spec) -> dict[str, str]:
    """Return the places of the copies of data files, by the names in the run file; each has a name of its own."""
    names = Counter(Path(name).name for name in spec.files)
    return {
        name: f"{DATA_COPIES}/{digest[:8] + '-' if names[Path(name).name] > 1 else ''}{Path(name).name}"
        for name, digest in spec.files.items()
    }


def stream_pictures(spec: Spec) -> dict[str, str]:
    """Return the file of every stream's picture, and the stream's name: ``best_stream.png`` for a single one."""
    return {f"best_stream{'' if name == ONLY else f'_{name}'}.png": name for name in spec.streams}


def header(options: dict[str, Any]) -> str:
    """Return the comment on top of the resolved run file."""
    text = "The run file with every default filled in, as streamkit used it."
    if options.get("quick"):
        text += "\nQUICK LOOK: few particles, few steps, not converged. Not for science."
    return text


def _same_run(directory: Path, spec: Spec, files: list[str]) -> bool:
    """Check that the directory holds the run of this spec; return whether its chain has begun."""
    begun = any(name in files for name in (CHAIN, JOURNAL, SAMPLES, CALLS))
    if MANIFEST in files and not begun and RUN_FILE not in files and manifest(directory)["digest"] == spec.digest():
        return False  # it was killed between the first two files
    if MANIFEST not in files or RUN_FILE not in files:
        raise ChainError(
            f"{directory}: holds no run to resume ({MANIFEST} or {RUN_FILE} is missing, found "
            f"{_some(files)}). Choose another directory."
        )
    known = manifest(directory)
    digest = known["digest"]
    try:
        document = tomllib.loads((directory / RUN_FILE).read_text())
    except (OSError, ValueError) as error:
        raise ChainError(f"{directory / RUN_FILE}: not readable ({error})") from None
    if digest != spec.digest():
        document, here = (
            {key: value for key, value in found.items() if key not in ("plugins", "engine")}
            for found in (document, spec.with_files_at(_copies(spec)))
        )
        data = known.get("files", {})
        changed = differences(document, here)
        changed += [f"the data file {name}" for name, sha in spec.files.items() if data.get(name, sha) != sha]
        changed = changed or ["a plugin or streamkit itself"]
        if (was := document.get("sampler", {}).get("kind", DEFAULT_KIND["sampler"])) != spec.sampler.kind:
            told = f"the sampler: {was} there, {spec.sampler.kind} here, which cannot go on with the other's samples"
            changed = [told, *(one for one in changed if not one.startswith("sampler"))]
        raise ChainError(
            f"{directory}: holds another run, and its chain cannot be continued with this run file. "
            f"What differs (there -> here): {'; '.join(changed)}. "
            "Choose another directory, or --force to overwrite."
        )
    if not begun:
        return False
    if CALLS in files or SAMPLES in files:
        return True
    found = read_chain(directory)
    return len(found.chain) > 0 or found.start is not None


def _only_ours(directory: Path, files: list[str], products: Collection[str]) -> None:
    """Refuse to overwrite files that only happen to have our names: without a manifest they are not ours."""
    clash = [name for name in files if name in products]
    if odd := [name for name in clash if (directory / name).is_dir()]:
        raise ChainError(f"{directory}: {_some(odd)} is a directory, expected a file. Choose another directory.")
    if clash and MANIFEST not in files:
        raise ChainError(
            f"{directory}: {_some(clash)} would be overwritten, but without a {MANIFEST} "
            "they are not known to be streamkit's. Choose another directory."
        )


def _occupied(directory: Path, files: list[str]) -> str:
    if MANIFEST in files:
        return (
            f"{directory}: holds a run already. --resume continues it (with the same run file), "
            "--force overwrites it, or choose another directory."
        )
    return f"{directory}: is not empty (found {_some(files)}). Choose another directory."


def _some(files: list[str]) -> str:
    return ", ".join(files[:4]) + (f" and {len(files) - 4} more" if len(files) > 4 else "")


def _manifest(spec: Spec, options: dict[str, Any]) -> dict[str, Any]:
    packages = ("streamkit", "numpy", "scipy", "numba", "emcee", "astropy")
    return {
        "digest": spec.digest(),
        "seed": spec.seed,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in packages},
        "files": dict(spec.files),
        "components": {path: f"{cls.kind} from {supplier}" for path, cls, supplier in spec.components()},
        "options": options,
    }


def resume_command(directory: Path, options: dict[str, Any]) -> str:
    """Return the command that goes on with the run in a directory, with the options that it was begun with.

    It names the resolved run file there, which holds what was set on the command line too. Where classes were given in
    Python, which no command knows, it is the call in Python.
    """
    if given := options.get("given"):
        more = [f"components=[{', '.join(map(str, given))}]", *(["quick=True"] if options.get("quick") else [])]
        words = [repr(str(directory / RUN_FILE)), f"out={str(directory)!r}", *more, "resume=True"]
        return f"streamkit.run({', '.join(words)})"
    arguments = [str(word) for word in options.get("arguments", ["--quick"] if options.get("quick") else [])]
    words = [str(word) for word in options.get("launcher", ["streamkit"])]
    return shlex.join([*words, "run", str(directory / RUN_FILE), "-o", str(directory), *arguments, "--resume"])


def manifest(directory: Path) -> dict[str, Any]:
    """Read the manifest of a run; ChainError if there is none, or it is not readable."""
    try:
        found = json.loads((directory / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise ChainError(f"{directory}: no streamkit run: {MANIFEST} is not readable ({error})") from None
    if not (
        isinstance(found, dict) and isinstance(found.get("digest"), str) and isinstance(found.get("options", {}), dict)
    ):
        raise ChainError(f"{directory / MANIFEST}: not the manifest of a streamkit run")
    return found


def run_file(directory: Path, trust: bool = False) -> Path:
    """Return the run file of a run's directory.

    ChainError if it names plugin files: their code runs because a user asks for it, and not because it lies in a
    directory. To ``trust`` them is to ask, and so was to read the same files earlier in this process.
    """
    path = directory / RUN_FILE
    try:
        named = [] if trust else tomllib.loads(path.read_text()).get("plugins", [])
    except (OSError, ValueError, RecursionError):  # who reads it says what is wrong
        return path
    strange = [name for name in named if isinstance(name, str) and not is_loaded((directory / name).absolute())]
    if strange:
        raise ChainError(
            f"{path}: names the plugin file {strange[0]!r}, Python code that came with the directory and would be run. "
            "Look at it, and then add --trust (from Python, trust=True)."
        )
    return path


def check_data(directory: Path, spec: Spec) -> None:
    """Check that the copies of data files, which the spec in a directory read, are those of the run, or ChainError."""
    known = manifest(directory).get("files", {})
    for name, digest in spec.files.items():
        if isinstance(known, dict) and known and digest not in known.values():
            raise ChainError(
                f"{directory / name}: has changed since the run began: put back the file of the run, or start again."
            )


def read_chain(directory: Path) -> Chain:
    """Read the chain of a run; ChainError if it cannot be read, or is not that of this directory's run."""
    found = read_chain_file(directory / CHAIN)
    _is_own(directory, CHAIN, "chain", found.attributes)
    return found


def read_samples(directory: Path) -> Weighted | None:
    """Read the weighted samples of a run, None for one that keeps a chain; errors as those of `read_chain`."""
    if not any((directory / name).exists() for name in (SAMPLES, CALLS)):
        return None
    found = read_weighted(directory / SAMPLES)
    _is_own(directory, SAMPLES, "file of samples", found.attributes)
    return found


def _is_own(directory: Path, file: str, called: str, attributes: dict[str, Any]) -> None:
    wanted = manifest(directory)["digest"]
    digest = attributes.get("digest", wanted)
    if digest != wanted:
        raise ChainError(
            f"{directory / file}: is the {called} of another run, of digest {str(digest)[:12]}; that of "
            f"{MANIFEST} is {wanted[:12]}. Nothing was changed: put the right file back, or start again with --force."
        )
