"""The fits of a run file in several hosts, one after the other, each in a directory of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from streamkit.errors import Interrupted, SpecError, StreamkitError
from streamkit.fit import Results, run
from streamkit.runfile import Spec, read_toml
from streamkit.stream import Array
from streamkit.study.families.average import stacking_weights, weights_of
from streamkit.study.families.weights import EVIDENCE, STACKING


@dataclass(frozen=True)
class Family:
    """The finished fit in one host."""

    name: str
    results: Results

    @property
    def ln_evidence(self) -> tuple[float, float]:
        """Its ln evidence and the error; NaN where the sampler gives none, or has not ended by its rule."""
        weighted = self.results.weighted
        if weighted is None or self.results.draws.lacks:
            return np.nan, np.nan
        return weighted.ln_evidence, weighted.ln_evidence_error

    @cached_property
    def ln_density(self) -> Array:
        """(n,) ln of the density of each stream's data, given those of all others; NaN where it is not known.

        Data of the host count among the others: often no stream could do without them.
        """
        table = self.results.left_out()
        streams = [name in self.results.spec.streams for name in table["without"]]
        return np.array(table["ln_density"])[streams] if any(streams) else np.empty(0)


@dataclass(frozen=True)
class Families:
    """The finished fits of one run file in several hosts.

    Attributes
    ----------
    spec
        The run file.
    families
        The fits.
    by
        What their weights are made from, one of `WEIGHTS`.
    """

    spec: Spec
    families: tuple[Family, ...]
    by: str = EVIDENCE

    @property
    def unknown(self) -> tuple[str, ...]:
        """The families without what weights are made from."""
        return tuple(each.name for each in self.families if not self._is_known(each))

    def _is_known(self, each: Family) -> bool:
        known = each.ln_density if self.by == STACKING else each.ln_evidence[:1]
        return len(known) > 0 and bool(np.isfinite(known).all())

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """(k,) and (k,) Their weights and the errors of these: equal and NaN where one of them is unknown."""
        k = len(self.families)
        if self.unknown:
            return np.full(k, 1 / k), np.full(k, np.nan)
        if self.by == STACKING:
            return stacking_weights(np.stack([each.ln_density for each in self.families], axis=1), self.spec.seed)
        evidence, errors = np.array([each.ln_evidence for each in self.families]).T
        return weights_of(evidence, errors, self.spec.seed)


def host_of(spec: Spec, file: Path) -> Spec:
    """Return a run file with the section ``potential`` of another file, of which nothing else is read.

    Raises SpecError for a file without one, or with one that is not valid here.
    """
    document = read_toml(file)
    if "potential" not in document:
        raise SpecError(f"{file}: there is no section [potential], the host; found {', '.join(document) or 'nothing'}")
    try:
        return spec.with_host(document["potential"])
    except SpecError as error:
        raise SpecError(f"{file} as the host of {error}") from None


def run_families(
    specs: Mapping[str, Spec],
    out: Path,
    workers: int | None = None,
    resume: bool = False,
    force: bool = False,
    by: str = EVIDENCE,
    done: Callable[[], object] = lambda: None,
    tell: Callable[[str], object] | None = None,
) -> Families:
    """Fit all of several run files by name, each in its own directory of ``out``; ``done`` is called after each.

    Their weights are made from ``by``, one of `WEIGHTS`. With ``resume``, finished fits are read and unfinished ones go
    on. If ``tell`` is given, it is called with a sentence before each fit, and the progress of all is shown. The hosts
    differ, so that no call of one serves another.

    Raises StreamkitError for fewer than two, and whatever `streamkit.run` raises: fits before it stay.
    """
    if len(specs) < 2:
        raise StreamkitError(f"one host alone ({', '.join(specs)}): expected two or more to compare")
    streams = next(iter(specs.values())).streams
    if by == STACKING and len(streams) < 2:
        raise StreamkitError(
            f"found {len(streams)} stream{'s' * (len(streams) != 1)}, expected two or more: stacking predicts each of "
            f"several streams by the others; use --weights {EVIDENCE}"
        )
    families: list[Family] = []
    for i, (name, spec) in enumerate(specs.items(), start=1):
        directory = out / name
        going_on = resume and directory.exists()
        if tell is not None:
            tell(f"{directory}: fit {i} of {len(specs)}")
        try:
            results = run(spec, directory, workers=workers, resume=going_on, force=force, progress=tell is not None)
        except Interrupted as stop:  # its message continues this fit alone
            told = f"{directory}: interrupted; {len(families)} of {len(specs)} fits are finished; --resume goes on"
            raise Interrupted(told, stop.exit_status - 128) from None
        families.append(Family(name, results))
        done()
    return Families(next(iter(specs.values())), tuple(families), by)


def best_ln_likelihoods(families: Sequence[Family]) -> Array:
    """(k,) Return the largest ln likelihood of each family's samples."""
    return np.array([float(np.max(each.results.draws.predictions["ln_likelihood"]))
                     if each.results.draws.predictions is not None else np.nan for each in families])  # fmt: skip
