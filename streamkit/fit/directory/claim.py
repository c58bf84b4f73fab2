"""The output directory of a run: its owner, the files that may be written there, and copies of plugins and data."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any

from streamkit.components import ChainSampler, with_neighbours
from streamkit.errors import ChainError, SpecError, expect_file
from streamkit.fit.directory.integrity import (
    RESTORE,
    RUN_FILE,
    changed_plugins,
    copied_files,
    data_copies,
    load_spec,
    read_chain,
    warn_of_lost_steps,
)
from streamkit.fit.directory.manifest import MANIFEST, manifest, manifest_of
from streamkit.report import contents, replace_whole, safely
from streamkit.runfile import DEFAULT_KIND, ONLY, Spec, differences, read_toml, to_toml
from streamkit.sample import CHAIN, JOURNAL, SAMPLES, is_calls

# Folder with copies of the run's plugin files, and of the files that these import from beside them.
PLUGIN_COPIES = "plugins"
RECOVERY = ("recovery.ecsv", "recovery.png")  # products of a report with the truth
LITERATURE = "literature.ecsv"  # published values of a report, which later reports read


def claim(
    directory: Path, spec: Spec, options: dict[str, Any], products: Collection[str], resume: bool, force: bool
) -> bool:
    """Claim the directory for this run; return whether there is a chain to continue.

    The directory exists, and is `locked`. ``options`` are those of the command, for the manifest; ``products`` every
    file that a run or a report may write there. ``resume`` continues the same run, ``force`` overwrites another one.

    Raises ChainError if it holds files that must not be changed. Nothing has then been changed.
    """
    if resume and force:
        raise ChainError("resume and force exclude each other: continue the chain, or throw it away?")
    files = contents(directory)
    continues = False
    if files and resume:
        continues = _same_run(directory, spec, files)
    elif files and force:
        _only_ours(directory, files, products)
        for name in products:
            if name != MANIFEST:  # it identifies the owner of the directory until the new one replaces it
                (directory / name).unlink(missing_ok=True)
    elif files:
        raise ChainError(_occupied(directory, files))
    run_file = (directory / RUN_FILE).read_bytes() if continues else _run_file_text(spec, options).encode()
    content = json.dumps(manifest_of(spec, options, run_file), indent=2) + "\n"
    with safely(directory / MANIFEST):
        replace_whole(directory / MANIFEST, lambda part: part.write_bytes(content.encode()))
    if not continues:
        copies = {Path(place): spec.folder / name for name, place in data_copies(spec.files).items()}
        for place, file in (copies | _plugin_copies(spec)).items():  # the directory is then self-contained
            with safely(directory / place):
                _make_folder(directory, place.parent)
                replace_whole(directory / place, partial(shutil.copyfile, file))
        with safely(directory / RUN_FILE):
            replace_whole(directory / RUN_FILE, lambda part: part.write_bytes(run_file))
    return continues


def _make_folder(directory: Path, folder: Path) -> None:
    """Make a folder of copies; ChainError if the folder, or one above it, is a link."""
    for each in [*reversed(folder.parents), folder]:
        if each != Path() and (directory / each).is_symlink():
            raise ChainError(f"{directory / each}: is a link to another folder, into which nothing is written")
    (directory / folder).mkdir(parents=True, exist_ok=True)


def _run_file_text(spec: Spec, options: dict[str, Any]) -> str:
    """Return the resolved run file, which names the copies of its plugins and data files beside it."""
    document = spec.with_files_at(data_copies(spec.files))
    if plugins := spec.document.get("plugins", []):
        document["plugins"] = [f"{PLUGIN_COPIES}/{Path(name).name}" for name in plugins]
    components = [f"{path}: {cls.kind} ({supplier})" for path, cls, supplier in spec.components()]
    return to_toml(document, "\n".join([header(options), *components]))


def _plugin_copies(spec: Spec) -> dict[Path, Path]:
    """Return the plugin files and the neighbouring files that they import, by the places of their copies."""
    sources = [spec.folder / name for name in spec.document.get("plugins", [])]
    return {
        PLUGIN_COPIES / file.relative_to(source.parent): file for source in sources for file in with_neighbours(source)
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
    is_chain = isinstance(spec.sampler, ChainSampler)
    begun = any(name in (CHAIN, JOURNAL) if is_chain else name == SAMPLES or is_calls(name) for name in files)
    if MANIFEST in files and not begun and RUN_FILE not in files and manifest(directory)["digest"] == spec.digest():
        return False  # it was killed between the first two files
    if MANIFEST not in files or RUN_FILE not in files:
        raise ChainError(
            f"{directory}: holds no run to resume ({MANIFEST} or {RUN_FILE} is missing, found "
            f"{_some(files)}). Choose another directory."
        )
    record = manifest(directory)
    if record["digest"] != spec.digest():
        raise ChainError(
            f"{directory}: holds another run, and its chain cannot be continued with this run file. "
            f"What differs (there -> here): {'; '.join(_differences(directory, spec, record))}. "
            "Choose another directory, or --force to overwrite."
        )
    if not begun:
        return False
    _check_copies(directory, spec)
    if not is_chain:
        return True
    chain = read_chain(directory)
    if chain.lacks_journal:
        warn_of_lost_steps(directory, chain)
    if chain.chain.shape[2] != len(spec.names):
        raise ChainError(f"{directory}: the chain has {chain.chain.shape[2]} parameters, and the run {len(spec.names)}")
    return len(chain.chain) > 0 or chain.start is not None


def _differences(directory: Path, spec: Spec, record: dict[str, Any]) -> list[str]:
    """Return the differences between the run in a directory and the run of a spec."""
    try:
        there = read_toml(directory / RUN_FILE)
    except SpecError as error:
        raise ChainError(str(error)) from None
    document, here = (
        {key: value for key, value in each.items() if key not in ("plugins", "engine")}
        for each in (there, spec.with_files_at(data_copies(spec.files)))
    )
    changed = differences(document, here)
    copied = copied_files(record)
    changed += [
        f"the data file {name}"
        for name, place in data_copies(spec.files).items()
        if copied.get(place, spec.files[name]) != spec.files[name]
    ]
    changed += [f"the plugin file {name}" for name in changed_plugins(spec, record)]
    sampler = document.get("sampler")
    kind = sampler.get("kind", DEFAULT_KIND["sampler"]) if isinstance(sampler, dict) else DEFAULT_KIND["sampler"]
    if kind != spec.sampler.kind:
        difference = f"the sampler: {kind} there, {spec.sampler.kind} here, which cannot continue the other's samples"
        changed = [difference, *(one for one in changed if not one.startswith("sampler"))]
    return changed or ["a plugin or streamkit itself"]


def _check_copies(directory: Path, spec: Spec) -> None:
    """Check the run file in the directory and its copies, from which the samples are reported at the end."""
    for place, source in _plugin_copies(spec).items():
        try:
            expect_file(directory / place)
            is_same = (directory / place).read_bytes() == source.read_bytes()
        except OSError as error:
            raise ChainError(f"{directory / place}: cannot be read ({error.strerror}). {RESTORE}") from None
        if not is_same:
            raise ChainError(f"{directory / place}: has changed since the run began. {RESTORE}")
    try:
        load_spec(directory, spec.given)
    except SpecError as error:
        raise ChainError(f"{error}\n{RESTORE}") from None


def _only_ours(directory: Path, files: list[str], products: Collection[str]) -> None:
    """Refuse to overwrite files with the names of products if there is no manifest: they are not streamkit's."""
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


def resume_command(directory: Path, options: dict[str, Any], steps: int | None = None) -> str:
    """Return the command that continues the run in a directory, with the options that it was begun with.

    It names the resolved run file, which includes the settings of the command line. If classes were given in Python,
    it is a call in Python, as no command can load them. ``steps`` is another largest number of steps, for a run that
    has reached its own.
    """
    if given := options.get("given"):
        more = [f"components=[{', '.join(map(str, given))}]", *(["quick=True"] if options.get("quick") else [])]
        more += [f"steps={steps}"] if steps is not None else []
        words = [repr(str(directory / RUN_FILE)), f"out={str(directory)!r}", *more, "resume=True"]
        return f"streamkit.run({', '.join(words)})"
    arguments = list(options["arguments"])
    if steps is not None:
        at = arguments.index("--steps") if "--steps" in arguments else len(arguments)
        arguments[at : at + 2] = ["--steps", str(steps)]
    words = [*options["launcher"], "run", str(directory / RUN_FILE), "-o", str(directory), *arguments]
    return shlex.join([*words, "--resume"])
