"""The storage of a run: its samples during the run, the reason of its end, and the text after an interruption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from streamkit import sample
from streamkit.components import ChainSampler, Sampler
from streamkit.errors import ChainError, ComponentError, SpecError
from streamkit.fit.directory.integrity import LOG, load_spec, warn_of_lost_calls
from streamkit.fit.history import AnswerHistory
from streamkit.runfile import Spec
from streamkit.stream import Array

SAME = 1.0  # largest difference of ln p between machines, by rounding


class StoredRun:
    """The samples of a run, in the files of its directory, or in memory without one.

    ``values`` (m,) are the data, ``factors`` the factors for a sampler that emulates several streams. ``resumes``
    states whether there are samples to continue. Raises ChainError for files that cannot be read.
    """

    def __init__(
        self,
        directory: Path | None,
        spec: Spec,
        values: Array,
        factors: Sequence[sample.FactorPosterior],
        quick: bool,
        resumes: bool,
    ) -> None:
        digest, sampler = spec.digest(), spec.sampler
        self._directory, self._spec, self._factors = directory, spec, factors
        self._notes = {"quick": quick, "digest": digest}
        self._weighted: sample.Weighted | None = None
        self._before: sample.Weighted | None = None  # the samples that a resumed run begins with
        self._history = AnswerHistory(spec)
        if isinstance(sampler, ChainSampler):
            self.storage = sample.chain_storage(directory, {"status": "unfinished", **self._notes}, resumes)
        else:
            whole = sample.calls_storage(directory, digest, len(spec.names), values, sampler.emulates)
            self.storage = replace(whole, factors={each.name: each.storage(directory) for each in factors})
            if directory is not None and resumes:
                self._before = _samples_before(directory / sample.SAMPLES)
            if directory is not None and self._before is not None:
                warn_of_lost_calls(directory, self._before, self.storage.calls)

    def expect_same(self, posterior: sample.Posterior, limit: float) -> None:
        """Evaluate a stored sample of a resumed run again; ChainError if its ln p has changed."""
        last = self.storage.chain.last
        if last is not None:
            best = int(np.argmax(last.log_prob))
            self._expect(posterior, last.coords[best], float(last.log_prob[best]), limit)
        pairs = [(posterior, self.storage), *((each.full, self.storage.factors[each.name]) for each in self._factors)]
        for one, storage in pairs:
            if last is None and (first := storage.evaluations.any_good()) is not None:
                self._expect(one, first, storage.evaluations.get(first[None])[0].lnp, limit)

    def has_ended(self, sampler: Sampler) -> bool:
        """Return whether the weighted samples of a resumed run have ended by the rule of this sampler, as it is."""
        if self._directory is None or self._before is None or self._before.lacks:
            return False
        return bool(load_spec(self._directory, self._spec.given).sampler == sampler)

    def take(self, directory: Path | None) -> None:
        """Let the calls in a directory serve; without one those of all streams together, of an earlier version.

        Raises ChainError for calls that cannot be read.
        """
        storages = dict(self.storage.factors)
        begun = any(len(each.evaluations) or len(each.earlier) for each in storages.values())
        if directory is not None:
            if not self._spec.sampler.emulates:
                raise SpecError("reuse: serves the sampler emulator only")
            factors = self._factors or [sample.whole_posterior(self._spec)]
            storages = storages or {factors[0].name: self.storage}
            taken = sample.take_earlier(factors, storages, directory, load_spec(directory))
            LOG.info("%s: %s", directory, ", ".join(f"{count} calls of {name}" for name, count in taken.items()))
        elif len(self.storage.evaluations) and storages and not begun:
            for each in self._factors:
                found = sample.part_of_joint(self.storage.evaluations, self._factors, each)
                storages[each.name].earlier.take(found)

    def _expect(self, posterior: sample.Evaluates, point: Array, before: float, limit: float) -> None:
        after = sample.first_call(limit, posterior.evaluate, point).lnp
        if abs(after - before) > SAME:
            raise ChainError(
                f"{self._directory}: its samples are of another posterior: ln p of one of them was {before:.2f} and is "
                f"{after:.2f} now. streamkit, a plugin or another package has changed since. Choose another directory, "
                "or --force to overwrite."
            )

    def keep(self, weighted: sample.Weighted, asked: tuple[int, int], late: bool) -> None:
        """Store weighted samples in place of the previous ones, unless they lack more.

        They come after so many calls with all particles and with few; ``late`` says that the time limit is over.
        """
        over = "time" if late else "unfinished"
        status = "converged" if not weighted.lacks else over if weighted.missing else "few"
        weighted.attributes.update(status=status, **self._notes)
        weighted.attributes["history"] = self._history.after(weighted, asked)
        self._weighted = weighted
        if self._directory is not None and not self._is_worse(weighted):
            weighted.write(self._directory / sample.SAMPLES)

    def finish(self, sampler: Sampler, late: bool) -> None:
        """Store the reason of the end; ComponentError if there are no samples."""
        chain = self.storage.chain
        if isinstance(sampler, ChainSampler):
            converged = chain.iteration and sampler.convergence(chain.samples())
            chain.note(status="converged" if converged else "time" if late else "steps")
            chain.consolidate()
        elif self._weighted is None:
            raise ComponentError(f"sampler {sampler.kind}: gave no samples")
        elif self._is_worse(self._weighted):
            LOG.warning(
                "%s: the previous samples are kept: %s. The samples of the resumed run: %s.",
                self._directory, _described(self._before), _described(self._weighted),
            )  # fmt: skip

    def _is_worse(self, weighted: sample.Weighted) -> bool:
        """Return whether samples are worse than the samples that the run was resumed with."""
        return self._before is not None and _rank(self._before) < _rank(weighted)

    def samples(self) -> sample.Chain | sample.Weighted:
        """Return the samples of a run in memory. ChainError if it ended before its first step."""
        return self._weighted or self.storage.chain.whole()

    def left(self, again: str) -> str:
        """Return a sentence with the finished part of an interrupted run, and the command ``again`` that resumes it."""
        directory, steps = self._directory, self.storage.chain.iteration
        calls, small = (0, 0) if self.storage.is_chain else (self.storage.calls, self.storage.small_calls)
        few = f"{small} calls with few particles"
        done = " and ".join([f"{calls} calls"] * bool(calls) + [few] * bool(small)) or f"{steps} steps"
        if directory is None:
            return f"{done}, which are not saved: set `out` to keep the samples."
        if calls or small:
            return f"{done}, all of them in {directory}. To continue: {again}"
        if steps == 0:
            return f"no finished step. To begin again: {again}"
        where = [directory / name for name in (sample.CHAIN, sample.JOURNAL) if (directory / name).exists()]
        if not where:
            return f"{steps} finished steps, which are no longer in {directory}. To begin again: {again}"
        return f"{steps} finished steps, all of them in {' and '.join(map(str, where))}. To continue: {again}"


def _samples_before(path: Path) -> sample.Weighted | None:
    """Return the samples in a file; None if there are none yet, or they are damaged."""
    try:
        return sample.read_weighted(path)
    except ChainError as error:
        if path.exists():
            LOG.warning("%s. The samples are computed again from the calls.", error)
        return None


def _rank(weighted: sample.Weighted) -> tuple[bool, bool, float]:
    """Return the key that sorts samples, the best first: by the sampler's rule, then by their effective number."""
    return bool(weighted.missing), bool(weighted.lacks), 0.0 if weighted.missing else -weighted.ess


def _described(weighted: sample.Weighted | None) -> str:
    return "none" if weighted is None else weighted.lacks or f"{weighted.ess:.0f} effective samples"
