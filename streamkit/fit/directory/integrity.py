"""The files of a run's directory, each read only if it belongs to the run that the manifest names."""

from __future__ import annotations

import hashlib
import logging
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from streamkit.components import IN_PYTHON, ChainSampler, Component, is_loaded
from streamkit.distribution import VERSION
from streamkit.errors import ChainError, SpecError, expect_file
from streamkit.fit.directory.manifest import MANIFEST, manifest
from streamkit.report import is_locked
from streamkit.runfile import Spec, differences, load, read_toml
from streamkit.sample import (
    CALLS,
    CHAIN,
    JOURNAL,
    SAMPLES,
    Chain,
    Posterior,
    Weighted,
    is_calls,
    read_chain_file,
    read_weighted,
)
from streamkit.stream import Array

LOG = logging.getLogger("streamkit")
RUN_FILE = "run.toml"
ROUNDING = 1e-6  # relative difference of ln p that another machine, or version of SciPy, may make
DATA_COPIES = "data"  # folder with copies of the run's data files
RESTORE = "Put back the file of the run, or start again with --force."
FILE_SUPPLIER = re.compile(r"(.+\.py) sha256:[0-9a-f]+")  # supplier of a component from a plugin file


def run_file(directory: Path, trust: bool = False) -> Path:
    """Return the run file of a run's directory.

    Raises ChainError if it names plugin files, unless they are trusted: code that lies in a directory must not run by
    itself. Files that this process has read before are trusted. Raises SpecError if the file is not readable.
    """
    path = directory / RUN_FILE
    # by the reader of run files: a file that another one cannot read might still be run
    plugins = [] if trust else read_toml(path).get("plugins", [])
    files = [name for name in plugins if isinstance(name, str)] if isinstance(plugins, list) else []
    foreign = [name for name in files if not is_loaded((directory / name).absolute())]
    if foreign:
        raise ChainError(
            f"{path}: names the plugin file {foreign[0]!r}, Python code that came with the directory and would be run. "
            "Look at it, and then add --trust (from Python, trust=True)."
        )
    return path


def load_spec(directory: Path, components: Iterable[type[Component]] = (), trust: bool = False) -> Spec:
    """Read the run file of a run's directory; the arguments are those of `load_results`.

    Raises ChainError if the run file, a plugin file or a data file is not that of the run, or if plugin files may not
    be run. Raises SpecError if the run file is not valid.
    """
    record = manifest(directory)
    path = directory / RUN_FILE
    try:
        spec = load(run_file(directory, trust), components=components)
    except SpecError as error:
        lost = sorted(text for text in record["components"].values() if IN_PYTHON in text)
        if lost and not components:
            reason = f"{directory}: the run had components given in Python ({'; '.join(lost)})"
            raise ChainError(f"{reason}: read it in Python, with load_results(directory, components=[...])") from error
        if not _is_unchanged(path, record):
            raise ChainError(f"{path}: has changed since the run began, or is damaged: {error}\n{RESTORE}") from error
        raise
    _check_spec(directory, spec, record)
    return spec


def _check_spec(directory: Path, spec: Spec, record: dict[str, Any]) -> None:
    """Check that a spec read in a directory is that of the manifest; ChainError with the file that differs."""
    copied = copied_files(record)
    for name, digest in spec.files.items():
        if copied and copied.get(name) != digest:
            raise ChainError(f"{directory / name}: has changed since the run began. {RESTORE}")
    if names := changed_plugins(spec, record):
        raise ChainError(f"{directory}: the plugin file {names[0]} has changed since the run began. {RESTORE}")
    suppliers = {where: text.partition(" from ")[2] for where, text in record["components"].items()}
    others = {supplier for path, _, supplier in spec.components() if suppliers.get(path, supplier) != supplier}
    path = directory / RUN_FILE
    if others:
        made = sorted(set(suppliers.values()) - {supplier for _, _, supplier in spec.components()})
        LOG.warning("%s: the run was made with %s, and is read with %s.", directory, ", ".join(made),
                    ", ".join(sorted(others)))  # fmt: skip
    if spec.digest(suppliers) == record["digest"] or _is_unchanged(path, record):
        return
    made_with, here = record["versions"].get("streamkit", ""), VERSION
    if not record["run_file"] and made_with != here:  # a field may have been added since
        LOG.warning("%s: cannot be compared with the run, which streamkit %s made.", path, made_with)
        return
    raise ChainError(
        f"{path}: has changed since the run began: it is the run file of another run, of digest "
        f"{spec.digest(suppliers)[:12]}; that of {MANIFEST} is {record['digest'][:12]}. {RESTORE}"
    )


def data_copies(files: Mapping[str, str]) -> dict[str, str]:
    """Return the places of the copies of data files, by the names in the run file; no two places are equal.

    ``files`` are their SHA-256 by these names.
    """
    names = Counter(Path(name).name for name in files)
    return {
        name: f"{DATA_COPIES}/{digest[:8] + '-' if names[Path(name).name] > 1 else ''}{Path(name).name}"
        for name, digest in files.items()
    }


def copied_files(record: dict[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the copies of data files that a manifest names, by their places."""
    return {place: record["files"][name] for name, place in data_copies(record["files"]).items()}


def changed_plugins(spec: Spec, record: dict[str, Any]) -> list[str]:
    """Return the names of the plugin files whose code in a spec differs from that in a manifest."""
    names = []
    for where, cls, supplier in spec.components():
        file, before = FILE_SUPPLIER.fullmatch(supplier), record["components"].get(where)
        if file and before not in (None, f"{cls.kind} from {supplier}"):
            names.append(file[1])
    return sorted(set(names))


def _is_unchanged(path: Path, record: dict[str, Any]) -> bool:
    """Return whether the run file is byte for byte that of the manifest: then a newer streamkit may read it."""
    try:
        expect_file(path)
        return bool(hashlib.sha256(path.read_bytes()).hexdigest() == record["run_file"])
    except OSError:
        return False


def judged_spec(directory: Path, spec: Spec) -> Spec:
    """Return a spec that was read in a directory with the limits by which its run was last sampled.

    They say whether a chain has converged. Others in an edited run file are a warning in the log: a resumed run takes
    them.
    """
    if not isinstance(spec.sampler, ChainSampler):
        return spec
    record, path, noted = manifest(directory), directory / RUN_FILE, spec.sampler.stopping
    limits = {f"sampler.{name}": value for name, value in (record["limits"] or {}).items() if name in noted}
    here = {where: spec.document["sampler"].get(where.partition(".")[2]) for where in limits}
    if record["run_file"] and not _is_unchanged(path, record):
        edits = "; ".join(differences(limits, here))
        if edits:
            LOG.warning("%s: has been edited since the run began or was resumed (%s). Convergence is judged by the "
                        "former; a resumed run takes the latter.", path, edits)  # fmt: skip
        elif record["limits"] is None:
            LOG.warning("%s: has been edited since the run began or was resumed. Convergence is judged by the limits "
                        "that it has now.", path)  # fmt: skip
    try:
        return spec if here == limits else spec.with_values(limits)
    except SpecError as error:
        raise ChainError(f"{directory / MANIFEST}: limits: {error}") from None


def read_stored(directory: Path, spec: Spec) -> Chain | Weighted:
    """Read the samples of a run, by the sampler of its spec; errors as those of `read_chain`.

    A warning in the log says that steps, or calls, are gone.
    """
    if not isinstance(spec.sampler, ChainSampler):
        samples = read_samples(directory)
        _check_samples(directory / SAMPLES, spec, samples.points, samples.log_prob, samples.blobs)
        if not any(path.stat().st_size for path in directory.iterdir() if is_calls(path.name)):
            warn_of_lost_calls(directory, samples, 0)
        return samples
    chain = read_chain(directory)
    if len(chain.chain):
        _check_samples(directory / CHAIN, spec, chain.chain, chain.log_prob, chain.blobs)
    if chain.lacks_journal and not is_locked(directory):  # a running run may be about to write it
        warn_of_lost_steps(directory, chain)
    return chain


def _check_samples(path: Path, spec: Spec, points: Array, log_prob: Array, blobs: Any) -> None:
    """Check samples (..., d) against their run: parameters, data, and ln p as the sum of prior and likelihood.

    Raises ChainError if one of them is of another run, or was changed.
    """
    m, d = Posterior(spec).size, len(spec.names)
    found = blobs.dtype["mean"].shape[0], points.shape[-1]
    if found != (m, d):
        raise ChainError(f"{path}: belongs to another run: its samples have {found[1]} parameters and {found[0]} data, "
                         f"those of {RUN_FILE} are {d} and {m}. {RESTORE}")  # fmt: skip
    columns = np.moveaxis(points.reshape(-1, d), 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        ln_prior = sum(prior.lnpdf_of_many(x) for prior, x in zip(spec.priors, columns, strict=True))
        away = np.abs(ln_prior + blobs["ln_likelihood"].ravel() - log_prob.ravel())
    wrong = np.isfinite(log_prob.ravel()) & ~(away <= ROUNDING * (1 + np.abs(log_prob.ravel())))
    if wrong.any():
        raise ChainError(f"{path}: was damaged or changed after it was written: ln p of {wrong.sum()} of {wrong.size} "
                         f"samples is not that of their prior and likelihood. {RESTORE}")  # fmt: skip


def warn_of_lost_steps(directory: Path, chain: Chain) -> None:
    """Write into the log that the journal of a chain is gone."""
    LOG.warning("%s: is missing or empty, and the run was not at its end. Steps after step %d are lost, if there were "
                "any.", directory / JOURNAL, len(chain.chain))  # fmt: skip


def warn_of_lost_calls(directory: Path, samples: Weighted, there: int) -> None:
    """Write into the log that there are fewer calls than the samples of a run were made from."""
    made = samples.attributes.get("counts", {}).get("calls", 0)
    if there < made:
        LOG.warning("%s: the files of calls, such as %s, hold %d of the %d calls that the samples were made from. A "
                    "resumed run makes the others again.", directory, CALLS, there, made)  # fmt: skip


def read_chain(directory: Path) -> Chain:
    """Read the chain of a run; ChainError if it cannot be read, or is not that of this directory's run."""
    chain = read_chain_file(directory / CHAIN)
    _check_digest(directory, CHAIN, "chain", chain.attributes)
    return chain


def read_samples(directory: Path) -> Weighted:
    """Read the weighted samples of a run; errors as those of `read_chain`."""
    samples = read_weighted(directory / SAMPLES)
    _check_digest(directory, SAMPLES, "file of samples", samples.attributes)
    return samples


def _check_digest(directory: Path, file: str, noun: str, attributes: dict[str, Any]) -> None:
    wanted = manifest(directory)["digest"]
    digest = attributes.get("digest", wanted)
    if digest != wanted:
        raise ChainError(
            f"{directory / file}: is the {noun} of another run, of digest {str(digest)[:12]}; that of "
            f"{MANIFEST} is {wanted[:12]}. Nothing was changed: put the right file back, or start again with --force."
        )
