"""A fit, from a spec to its products. No finished step is lost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic

import numpy as np

from streamkit import sample
from streamkit.components import ChainSampler, Component, Sampler
from streamkit.errors import ChainError, ComponentError, Interrupted, SpecError
from streamkit.fit.directory.claim import LITERATURE, RECOVERY, claim, resume_command
from streamkit.fit.products import pdfs_of, products_of, write_products
from streamkit.fit.samples.results import Results, draws_of, load_results
from streamkit.fit.show.literature import read_literature
from streamkit.model import Host
from streamkit.observe import radii_of
from streamkit.report import locked
from streamkit.runfile import Engine, Source, Spec, as_spec

QUICK_PARTICLES = 2000
QUICK_SEARCH = 50.0  # seconds after the beginning of a quick run when its search ends
QUICK_SAMPLING = 140.0  # the same for its sampling: with the report it must take 3 minutes at most

SAME = 1.0  # difference of ln p that another machine's rounding may make
FOREIGN = 8  # assumed number of points that an executor of others evaluates at a time


def run(
    spec: Source,
    out: str | Path | None = None,
    workers: int | Executor | None = None,
    steps: int | None = None,
    quick: bool = False,
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
    products: bool = True,
    literature: str | Path | None = None,
    pdf: bool = False,
    components: Iterable[type[Component]] = (),
    engine: str | None = None,
    scheduler: str | None = None,
) -> Results:
    """Sample the posterior of a spec.

    Parameters
    ----------
    spec
        What to fit: a spec, the path of a run file, or a mapping of the same form.
    out
        Directory for the chain and all products; None keeps the samples in memory.
    workers
        Processes that evaluate the posterior, or any `concurrent.futures.Executor`. The samples do not depend on them.
        None: the number in ``[engine]`` of the run file; likewise for ``engine`` and ``scheduler``.
    steps
        Largest length of the chain, steps of a resumed run included; else ``sampler.steps`` of the spec. A sampler
        without steps takes none.
    quick
        A coarse look within 3 minutes on two cores: few particles, few steps. Every product is marked as such.
    resume, force
        Continue the run in ``out``; or overwrite what streamkit wrote there.
    progress
        Show progress: a bar on a terminal or in a notebook, elsewhere a line every minute.
    products
        Write tables and pictures at the end, if there is a directory.
    literature
        A table of published masses and circular velocities to show beside the run's own (`write_products`).
    pdf
        Write the pictures as PDF too.
    components
        Component classes as they are, from a notebook or a script, for the spec to be read with.
    engine
        Where the posterior is evaluated: "processes", "serial", "mpi" or "dask".
    scheduler
        Address of a running Dask scheduler.

    Returns
    -------
    Results
        The samples.

    Raises ChainError if ``out`` holds something else, or a chain that cannot be read. Nothing is then changed. Raises
    ComponentError if a component fails: with its name and the parameters. All finished steps stay readable. Raises
    Interrupted after Ctrl-C or SIGTERM. All finished steps stay readable.
    """
    begin, spec = monotonic(), as_spec(spec, components)
    if quick:
        spec = quick_spec(spec)
    sampler = spec.sampler
    if steps is not None and not isinstance(sampler, ChainSampler):
        raise SpecError(f"steps: the sampler {sampler.kind!r} has none. What ends it stands in [sampler].")
    if steps is not None:
        sampler = sampler.model_copy(update={"steps": steps})
    posterior, cheap = (sample.Posterior(each, sampler.emulates) for each in (spec, cheap_spec(spec)))
    directory = None if out is None else Path(out)
    if literature is not None:
        read_literature(literature)  # an error in it is raised now, not after the sampling
    wanted = _engine(spec, workers, engine, scheduler)
    with ExitStack() as stack:
        stack.enter_context(sample.one_thread())  # for the surrogate, which learns here, and for calls without workers
        where = workers if isinstance(workers, Executor) else stack.enter_context(sample.engine(wanted))
        # compiles once, before workers fork; fails before anything is written
        sample.first_call(sampler.call_limit, posterior.evaluate, spec.centre())
        options = {
            "quick": quick,
            "steps": getattr(sampler, "steps", None),
            "arguments": _arguments(spec, wanted, steps, quick, literature, pdf),
            "launcher": sample.launcher(wanted, where),
            "given": [cls.__qualname__ for cls in spec.given],
        }
        resumes = False
        if directory is not None:
            stack.enter_context(locked(directory))
            stores = (sample.CHAIN, sample.JOURNAL, sample.SAMPLES, sample.CALLS, sample.SMALL_CALLS)
            ours = (*products_of(spec), *pdfs_of(spec), *stores, *RECOVERY, LITERATURE)
            resumes = claim(directory, spec, options, ours, resume, force)
        limit, reject = sampler.call_limit, sampler.over_limit == "reject"
        posteriors = {"full": posterior, "cheap": cheap}
        pool = stack.enter_context(sample.Workers(posteriors, where, limit=limit, reject=reject))
        stored = _Stored(directory, spec, quick, resumes)
        stored.expect_same(posterior, sampler.call_limit)
        again = resume_command(directory or Path(), options)
        stack.enter_context(_explained(pool, lambda: stored.left(again)))
        radius = _measured_radius(spec)
        target = sample.PosteriorTarget(
            spec.priors, posterior.data, spec.seed, pool, stored.cache, stored.chain,
            resumes=resumes,
            workers=where if isinstance(where, int) else FOREIGN,
            deadline=begin + QUICK_SAMPLING if quick else np.inf,
            search_deadline=begin + QUICK_SEARCH if quick else np.inf,
            progress=progress,
            mass=(radius, lambda theta: float(Host(spec.host(theta)).mass_inside(np.array([radius]))[0])),
            full_cost=_particles(spec) / _particles(cheap_spec(spec)),
            small_cache=stored.small_cache,
            posterior=posterior if sampler.emulates else None,
        )  # fmt: skip
        for weighted in target.run(sampler):
            stored.keep(weighted, target.time_left() < 0)
        stored.finish(sampler, target.time_left() < 0)
    if directory is None:
        return Results(spec, draws_of(stored.samples(), spec, quick))
    results = load_results(directory, spec.given)
    return write_products(results, literature=literature, pdf=pdf) if products else results


class _Stored:
    """The storage of a run's samples: the files of its directory, or memory without one.

    ``resumes`` says whether there are samples to continue.
    """

    def __init__(self, directory: Path | None, spec: Spec, quick: bool, resumes: bool) -> None:
        self._directory = directory
        self._notes = {"quick": quick, "digest": spec.digest()}
        self._is_chain = isinstance(spec.sampler, ChainSampler)
        self._weighted: sample.Weighted | None = None
        calls = None if directory is None or self._is_chain else directory / sample.CALLS
        self.cache = sample.EvaluationCache(calls, spec.digest())
        small = None if calls is None or not spec.sampler.emulates else calls.with_name(sample.SMALL_CALLS)
        self.small_cache = sample.EvaluationCache(small, spec.digest())
        self.chain = sample.ChainMemory() if directory is None else sample.ChainFile(directory / sample.CHAIN)
        self.chain.note(status="unfinished", **self._notes)
        if isinstance(self.chain, sample.ChainFile) and self._is_chain and resumes:
            self.chain.load()

    def expect_same(self, posterior: sample.Posterior, limit: float) -> None:
        """Evaluate a stored sample of a resumed run again; ChainError if its ln p has changed."""
        if self.chain.last is not None:
            best = int(np.argmax(self.chain.last.log_prob))
            point, before = self.chain.last.coords[best], float(self.chain.last.log_prob[best])
        elif (first := self.cache.any_good()) is not None:
            point, before = first, self.cache.get(first[None])[0].lnp
        else:
            return
        after = sample.first_call(limit, posterior.evaluate, point).lnp
        if abs(after - before) > SAME:
            raise ChainError(
                f"{self._directory}: its samples are of another posterior: ln p of one of them was {before:.2f} and is "
                f"{after:.2f} now. streamkit, a plugin or another package has changed since. Choose another directory, "
                "or --force to overwrite."
            )

    def keep(self, weighted: sample.Weighted, late: bool) -> None:
        """Store weighted samples; ``late`` if the time limit is over."""
        over = "time" if late else "unfinished"
        status = "converged" if not weighted.lacks else over if weighted.missing else "few"
        weighted.attributes.update(status=status, **self._notes)
        self._weighted = weighted
        if self._directory is not None:
            weighted.write(self._directory / sample.SAMPLES)

    def finish(self, sampler: Sampler, late: bool) -> None:
        """Store why the sampling ended; ComponentError if there are no samples."""
        if isinstance(sampler, ChainSampler):
            converged = self.chain.iteration and sampler.convergence(self.chain.samples())
            self.chain.note(status="converged" if converged else "time" if late else "steps")
            self.chain.consolidate()
        elif self._weighted is None:
            raise ComponentError(f"sampler {sampler.kind}: gave no samples")

    def samples(self) -> sample.Chain | sample.Weighted:
        """Return the samples of a run in memory. ChainError if it ended before its first step."""
        return self._weighted or self.chain.whole()

    def left(self, again: str) -> str:
        """Return what an interrupted run leaves, and the command ``again`` that resumes it."""
        directory, steps, calls = self._directory, self.chain.iteration, 0 if self._is_chain else len(self.cache)
        done = f"{calls} calls" if calls else f"{steps} steps"
        if directory is None:
            return f"{done}, which were kept in memory only and are lost: give `out` to keep them."
        if calls:
            return f"{done}, all of them in {directory / sample.CALLS}. To continue: {again}"
        if steps == 0:
            return f"no finished step. To begin again: {again}"
        where = [directory / name for name in (sample.CHAIN, sample.JOURNAL) if (directory / name).exists()]
        if not where:
            return f"{steps} finished steps, of which nothing is left in {directory}. To begin again: {again}"
        return f"{steps} finished steps, all of them in {' and '.join(map(str, where))}. To continue: {again}"


def quick_spec(spec: Spec) -> Spec:
    """Return the spec of the coarse look: fewer particles and walkers, the noise of the former added."""
    settings = {f"sampler.{name}": value for name, value in spec.sampler.quick_settings(len(spec.names)).items()}
    return spec.with_particles(QUICK_PARTICLES).with_values({**settings, "likelihood.noise": "add"})


def cheap_spec(spec: Spec) -> Spec:
    """Return the spec that searches for a start: few particles, their noise added to the data's."""
    return spec.with_particles(spec.sampler.search_size()[1]).with_values({"likelihood.noise": "add"})


def _particles(spec: Spec) -> int:
    """Return the particles of all streams together."""
    return sum(stream.stripping.centre.particles for stream in spec.sections.streams.values())


def _measured_radius(spec: Spec) -> float:
    """Return the largest radius of the data in kpc, or that of a progenitor where none is known, with two digits."""
    bound = spec.bind_all()
    measured = [radii_of(inputs.observables) for inputs in bound.streams.values()] + [radii_of(bound.data)]
    radii = [radius for each in measured for radius in each.values()]
    radii = radii or [float(np.sqrt(inputs.q @ inputs.q)) for inputs in bound.streams.values()]
    return float(f"{max(radii):.2g}")


@contextmanager
def _explained(pool: sample.Workers, left: Callable[[], str]) -> Iterator[None]:
    """Turn signals into a clean stop. An error names the finished part and the command that continues the run."""
    try:
        with sample.stopped_by_signals(pool):
            yield
    except sample.Stopped as stop:
        raise Interrupted(f"stopped after {left()}", stop.signum) from None
    except (ComponentError, ChainError, SpecError, sample.CallTimeout, sample.WorkerDied) as error:
        raise type(error)(f"{error}. The run stopped after {left()}") from error


def _engine(spec: Spec, workers: int | Executor | None, kind: str | None, scheduler: str | None) -> Engine:
    """Return the engine of the run file with the given changes; SpecError if there is no such engine."""
    if isinstance(workers, Executor):
        if kind is not None or scheduler is not None:
            raise SpecError("workers: is an executor, which takes the place of an engine and its scheduler")
        return spec.engine
    given = {"kind": kind, "workers": workers, "scheduler": scheduler}
    if kind not in (None, "dask") and scheduler is None:
        given["scheduler"] = ""  # the scheduler of the run file belongs to its engine
    changed = {f"engine.{name}": value for name, value in given.items() if value is not None}
    return spec.with_values(changed).engine if changed else spec.engine


def _arguments(
    spec: Spec, chosen: Engine, steps: int | None, quick: bool, literature: str | Path | None, pdf: bool
) -> list[str]:
    """Return those arguments of the command that a resumed run needs too."""
    shown = [*(["--literature", str(literature)] if literature is not None else []), *(["--pdf"] if pdf else [])]
    words = {"--engine": "kind", "--scheduler": "scheduler", "--workers": "workers"}
    changed = [(word, str(getattr(chosen, name))) for word, name in words.items()
               if getattr(chosen, name) not in (getattr(spec.engine, name), "")]  # fmt: skip
    most = ["--steps", str(steps)] if steps is not None else []
    return [*(["--quick"] if quick else []), *(part for pair in changed for part in pair), *most, *shown]
