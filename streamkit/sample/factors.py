"""The factors of a posterior of several streams: each stream alone is a target of its own, with its own calls.

A call of a factor depends on the parameters of the host and on the factor's own. It is stored under the digest of the
run file of this stream alone: it stays valid when the run file gets another stream.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from streamkit.components import TargetFactor
from streamkit.runfile import DATA, Spec
from streamkit.runfile import Factor as Parameters
from streamkit.sample.calls.posterior import Posterior
from streamkit.sample.calls.serving import Evaluates
from streamkit.sample.calls.workers import Workers
from streamkit.sample.progress import SamplingProgress
from streamkit.sample.store.storage import Storage, calls_storage
from streamkit.sample.target import Deadlines, PosteriorTarget
from streamkit.stream import Array


@dataclass(frozen=True)
class FactorPosterior:
    """The posterior of one factor, with all particles and with few of them; these may be the same."""

    parameters: Parameters
    full: Posterior
    small: Posterior

    @property
    def name(self) -> str:
        """That of its stream; `DATA` for the data of the host."""
        return self.parameters.name

    @property
    def which(self) -> tuple[str, str]:
        """The names of both for `Workers`."""
        return f"full {self.name}", f"{'full' if self.small is self.full else 'small'} {self.name}"

    def details_at(self, theta: Array) -> int:
        """Return how many details a prediction at theta (d,) has, where there is one."""
        comparison = self.full.comparison
        if not comparison.knows_shapes:
            comparison.read_shapes(theta)
        return comparison.details_size

    def storage(self, directory: Path | None) -> Storage:
        """Return the storage of its calls; ChainError for calls that cannot be read, or of another stream."""
        spec = self.full.spec
        digest, values = spec.digest(sampler=False), self.full.data.values
        return calls_storage(directory, digest, len(spec.names), values, self.small is not self.full, self.name)


def factor_posteriors(spec: Spec, small: Spec) -> tuple[FactorPosterior, ...]:
    """Return the factors of a run file, and of it with few particles; none where there is one stream."""
    if len(spec.factors) == 1:
        return ()
    return tuple(_posterior(factor, spec, small) for factor in spec.factors)


def whole_posterior(spec: Spec) -> FactorPosterior:
    """Return the only factor of a run file of one stream: it has the data of the host too."""
    full = Posterior(spec, emulated=True)
    return FactorPosterior(spec.factors[0], full, full)


def part_posteriors(spec: Spec) -> tuple[FactorPosterior, ...]:
    """Return each stream of a run file, of one or of several, and the data of the host, as posteriors of their own."""
    return tuple(_posterior(part, spec, spec) for part in spec.parts)


def _posterior(factor: Parameters, spec: Spec, small: Spec) -> FactorPosterior:
    if factor.name == DATA:
        host = Posterior(_without_streams(spec), emulated=True, streams=False)
        return FactorPosterior(factor, host, host)
    full = Posterior(spec.only(factor.name, data=False), emulated=True)
    few = small.only(factor.name, data=False)
    of_both = [each.sections.streams[factor.name].stripping.centre.particles for each in (few, full.spec)]
    same = of_both[0] == of_both[1]
    return FactorPosterior(factor, full, full if same else Posterior(few, emulated=True))


def _without_streams(spec: Spec) -> Spec:
    """Return the spec of the data of the host alone: it keeps one stream, fixed and without observable."""
    if not spec.streams:
        return spec
    alone = spec.only(spec.streams[0], observables=False)
    centre = dict(zip(alone.names, alone.centre().tolist(), strict=True))
    own = {path: value for path, value in centre.items() if path.startswith(alone.prefix())}
    return alone.with_values(own)


def worker_posteriors(factors: Sequence[FactorPosterior]) -> dict[str, Evaluates]:
    """Return the posteriors of all factors by their names for `Workers`."""
    return {name: one for each in factors for name, one in zip(each.which, (each.full, each.small), strict=True)}


def factor_targets(
    factors: Sequence[FactorPosterior],
    seed: int,
    calls: Workers,
    storages: Mapping[str, Storage],
    deadlines: Deadlines,
    display: SamplingProgress,
) -> tuple[TargetFactor, ...]:
    """Return the targets of the factors, with which of all parameters each has."""
    found = []
    for each in factors:
        target = PosteriorTarget(
            each.full.spec.priors, each.full.data, seed, calls, storages[each.name], deadlines, display,
            each.full.comparison, each.which,
        )  # fmt: skip
        found.append(TargetFactor(each.name, each.parameters.shared, each.parameters.own, target))
    return tuple(found)
