"""The likelihood of each stream of a run as a function of the host, in a file that other fits read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from astropy.table import Column, Table

from streamkit.components import EmulatedLikelihood
from streamkit.distribution import VERSION
from streamkit.errors import StreamkitError
from streamkit.fit.directory.integrity import load_spec
from streamkit.fit.marginal.integral import Marginal, integrate
from streamkit.fit.marginal.stream_alone import StreamAlone
from streamkit.fit.marginal.surface import WANTED, Fitted, fit
from streamkit.report import save_table
from streamkit.runfile import Spec, host_values
from streamkit.sample import (
    SAMPLES,
    Deadlines,
    FactorPosterior,
    SamplingProgress,
    Storage,
    Workers,
    factor_targets,
    in_forks,
    one_thread,
    read_weighted,
    stored_streams,
)
from streamkit.stream import Array

WHOLE = 0.98  # part of the hosts within reach that counts in a domain without holes
FORM = "host likelihood 1"  # the form of the file, which the data kind `host_likelihood` reads
WHAT = (
    "ln of the likelihood of a stream, its own parameters integrated out, as a function of the host. Between the rows: "
    "the mean of a Gaussian process about a quadratic function, for |(y - centre) @ whiten| <= reach and low <= y <= "
    "high, where y are the columns, or the natural logarithms of those in 'logarithms'. Do not use it beyond, nor "
    "where two of the nearest three rows have no number."
)


def host_likelihood_files(directory: Path, trust: bool = False) -> list[str]:
    """Return the names of the files that `write_host_likelihoods` writes, one for each stream."""
    return [_file(name) for name in load_spec(directory, trust=trust).streams]


def write_host_likelihoods(
    directory: Path, out: Path, trust: bool = False, workers: int = 1, note: str = ""
) -> Iterator[tuple[Path, str]]:
    """Write the likelihood of each stream of a run as a function of the host; yield each file with a line about it.

    It follows from the stored calls of a run by a sampler that emulates predictions; the model is not called again.
    So many ``workers``, which are forks of this process, write a file each; the files do not depend on their number. A
    ``note`` on what the run's numbers are worth goes into their headers.

    Raises StreamkitError for a run by another sampler, a host without free parameters, or too few calls.
    """
    spec = load_spec(directory, trust=trust)
    if not spec.streams:
        raise StreamkitError(f"{directory}: the run has no stream: its run file has data on the host alone")
    shared = [spec.names[i] for i in spec.parts[0].shared]
    tops = ("potential.", "body.", "sun.")
    if not shared:
        raise StreamkitError(f"{directory}: no parameter of the host is free: there is nothing to be a likelihood of")
    if other := [name for name in shared if not name.startswith(tops)]:
        raise StreamkitError(f"{directory}: {other[0]} is free, and is no parameter of the host's sections "
                             "[potential], [body] and [sun]")  # fmt: skip
    joint = _joint(directory)
    with one_thread():
        streams = stored_streams(directory, spec)
        tasks = [partial(_written, directory, out, spec, *each, joint, note) for each in streams]
        for first in range(0, len(tasks), workers):
            yield from in_forks(tasks[first : first + workers], workers, lambda: None)


def _joint(directory: Path) -> Array | None:
    """(k, D) Return samples of the run; None if it has not come to its samples."""
    path = directory / SAMPLES
    if not path.exists():
        return None
    weighted = read_weighted(path)
    return np.asarray(weighted.points[weighted.drawn(0)])


def _file(stream: str) -> str:
    return f"{quote(stream, safe='')}_host.ecsv"


def _learned(directory: Path, spec: Spec, stream: FactorPosterior, storage: Storage) -> EmulatedLikelihood:
    """Return the likelihood of one stream that the sampler learns from its calls."""
    if not len(storage.earlier):
        raise StreamkitError(f"{directory}: there is no call of {stream.name} by the sampler emulator; it has the "
                             f"sampler {spec.sampler.kind}")  # fmt: skip
    calls = Workers(dict.fromkeys(stream.which, stream.full))
    (factor,) = factor_targets([stream], spec.seed, calls, {stream.name: storage}, Deadlines(), SamplingProgress())
    likelihood = spec.sampler.emulated(factor.target)
    if likelihood is None:
        raise StreamkitError(f"{directory}: the sampler {spec.sampler.kind} learns no likelihood; emulator does")
    return likelihood


def _written(
    directory: Path, out: Path, spec: Spec, stream: FactorPosterior, storage: Storage, joint: Array | None, note: str
) -> tuple[Path, str]:
    """Write the file of one stream; return it with a line about it."""
    path, likelihood = out / _file(stream.name), _learned(directory, spec, stream, storage)
    alone = stream.full.spec
    (part,) = (each for each in spec.parts if each.name == stream.name)
    own = np.isin(alone.names, [spec.names[i] for i in part.own])
    one = StreamAlone(likelihood, alone.priors, np.flatnonzero(~own), np.flatnonzero(own))
    good = np.array([np.frombuffer(key) for key, each in storage.earlier.all().items() if not each.reason])
    if joint is not None:
        joint = one.to(joint[:, [spec.names.index(name) for name in alone.names]])[:, one.shared]
    marginal = integrate(one, good, spec.seed, joint)
    try:
        fitted = fit(marginal)
    except StreamkitError as error:
        raise StreamkitError(f"{stream.name}: {error}") from None
    units = {alone.names[i]: alone.units[i] for i in one.shared}
    assumes = {name: value for name, value in host_values(alone.document).items() if name not in units}
    notes = {"calls": len(storage.earlier), "seed": spec.seed, "digest": alone.digest(sampler=False),
             "version": VERSION, "data": _sources(alone), "assumes": assumes,
             **({"note": note} if note else {})}  # fmt: skip
    save_table(path, table_of(stream.name, units, one, marginal, fitted, notes))
    short = "" if fitted.reach >= WANTED else f", less than the {WANTED:g} that other data in tension with it may need"
    hole = "" if fitted.kept > WHOLE else f", without the {1 - fitted.kept:.0%} of these hosts with no sure integral"
    line = (
        f"{stream.name}: {len(units)} parameters of the host, out to {fitted.reach:.1f} standard deviations of the "
        f"stream alone{short}{hole}; error of ln L {fitted.left_out:.2f}; {np.median(marginal.effective):.0f} "
        f"effective draws for a host ({np.quantile(marginal.effective, 0.05):.0f} for the poorest 5 %)"
    )
    return path, line


def table_of(
    stream: str,
    units: Mapping[str, str],
    one: StreamAlone,
    marginal: Marginal,
    fitted: Fitted,
    notes: Mapping[str, Any],
) -> Table:
    """Return the table of one stream; ``units`` are those of the host's parameters by their paths."""
    y = np.zeros((int(fitted.near.sum()), len(one.priors)))  # with any values of the stream's own parameters
    y[:, one.shared] = marginal.hosts[fitted.near]
    hosts, used = one.back(y)[:, one.shared], fitted.used[fitted.near]
    values, errors = np.full(len(y), np.nan), np.full(len(y), np.nan)
    values[used], errors[used] = marginal.ln_likelihood[fitted.used], fitted.errors
    columns = {
        name: Column(_short(column), unit=unit or None)
        for (name, unit), column in zip(units.items(), hosts.T, strict=True)
    }
    columns |= {"ln_likelihood": np.round(values, 4), "error": np.round(errors, 4)}
    low, high = one.ends()
    return Table(columns, meta={
        "streamkit": FORM, "what": WHAT, "stream": stream,
        "logarithms": [name for name, i in zip(units, one.shared, strict=True) if one.is_log[i]],
        "centre": fitted.centre.tolist(), "whiten": fitted.whiten.tolist(), "reach": fitted.reach,
        "low": _ends(low), "high": _ends(high), "width": fitted.width, "amplitude": fitted.amplitude,
        "left_out": fitted.left_out, "effective": float(np.median(marginal.effective)), **notes,
    })  # fmt: skip


def _short(column: Array) -> Array:
    """(n,) Return numbers with nine digits."""
    return np.array([float(f"{number:.9g}") for number in column])


def _ends(ends: Array) -> list[float | None]:
    return [float(end) if np.isfinite(end) else None for end in ends]


def _sources(alone: Spec) -> dict[str, str]:
    """Return the data of a stream: kind and reference of each observable, and the digests of its files."""
    observables = {path: f"{cls.kind} {cls.reference}".strip() for path, cls, _ in alone.components()
                   if cls.role == "observable"}  # fmt: skip
    return observables | {Path(name).name: f"sha256:{digest}" for name, digest in alone.files.items()}
