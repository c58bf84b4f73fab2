"""A fit, from a spec to its products. No finished step is lost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from streamkit import sample
from streamkit.components import Component, Sampler
from streamkit.errors import ChainError, ComponentError, Interrupted, SpecError
from streamkit.fit.directory.claim import LITERATURE, RECOVERY, claim, resume_command
from streamkit.fit.history import measured_radius
from streamkit.fit.options import arguments_of, cheap_spec, engine_of, quick_spec, sampler_of
from streamkit.fit.products import pdfs_of, products_of, write_products
from streamkit.fit.samples.results import Results, draws_of, load_results
from streamkit.fit.show.literature import read_literature
from streamkit.fit.stored import StoredRun
from streamkit.model import Host
from streamkit.report import locked
from streamkit.runfile import Engine, Source, Spec, as_spec
from streamkit.stream import Array

QUICK_SEARCH = 50.0  # seconds from the beginning of a quick run to the end of its search
QUICK_SAMPLING = 140.0  # seconds to the end of its sampling: with the report the run takes 3 minutes at most


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
    reuse: str | Path | None = None,
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
    reuse
        Directory of an earlier run by the sampler emulator, whose calls of the same streams serve: the run file may
        have got a stream, or other data.

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
    chosen = engine_of(spec, workers, engine, scheduler)
    plan = _Plan(
        spec,
        sampler_of(spec, steps),
        quick,
        directory=None if out is None else Path(out),
        workers=workers if isinstance(workers, Executor) else chosen,
        deadlines=sample.Deadlines(begin + QUICK_SAMPLING, begin + QUICK_SEARCH) if quick else sample.Deadlines(),
        arguments=arguments_of(spec, chosen, steps, quick, literature, pdf),
        progress=progress,
        reuse=None if reuse is None else Path(reuse),
    )
    if literature is not None:
        read_literature(literature)  # an error in the table is raised now, not after the sampling
    stored = _sample(plan, resume, force)
    if plan.directory is None:
        return Results(spec, draws_of(stored.samples(), spec, quick))
    results = load_results(plan.directory, spec.given)
    return write_products(results, literature=literature, pdf=pdf) if products else results


@dataclass(frozen=True)
class _Plan:
    """The settings of a run."""

    spec: Spec
    sampler: Sampler  # the sampler of the spec, with the steps of this call
    quick: bool
    directory: Path | None
    workers: Engine | Executor
    deadlines: sample.Deadlines
    arguments: list[str]  # the arguments of the command that a resumed run needs too
    progress: bool  # whether progress is shown
    reuse: Path | None = None  # a directory whose calls may serve

    def options(self, where: int | Executor) -> dict[str, Any]:
        """Return the notes on the command for the manifest, with workers that are ``where``."""
        engine = self.spec.engine if isinstance(self.workers, Executor) else self.workers
        return {
            "quick": self.quick,
            "steps": getattr(self.sampler, "steps", None),
            "arguments": self.arguments,
            "launcher": sample.launcher(engine, where),
            "given": [cls.__qualname__ for cls in self.spec.given],
        }


def _sample(plan: _Plan, resume: bool, force: bool) -> StoredRun:
    """Sample the posterior, and store the samples. The directory is claimed first, and locked during the sampling."""
    spec, sampler, directory = plan.spec, plan.sampler, plan.directory
    posterior, cheap = (sample.Posterior(each, sampler.emulates) for each in (spec, cheap_spec(spec)))
    with ExitStack() as stack:
        stack.enter_context(sample.one_thread())  # for the sampler in this process, and for calls without workers
        where = plan.workers if isinstance(plan.workers, Executor) else stack.enter_context(sample.engine(plan.workers))
        # compiles once, before workers fork; fails before anything is written
        sample.first_call(sampler.call_limit, posterior.evaluate, spec.centre())
        options, resumes = plan.options(where), False
        if directory is not None:
            stack.enter_context(locked(directory))
            ours = (*products_of(spec), *pdfs_of(spec), *sample.stores_of(spec), *RECOVERY, LITERATURE)
            resumes = claim(directory, spec, options, ours, resume, force)
        limit, reject = sampler.call_limit, sampler.over_limit == "reject"
        factors = sample.factor_posteriors(spec, cheap.spec) if sampler.emulates else ()
        posteriors = {"full": posterior, "cheap": cheap, **sample.worker_posteriors(factors)}
        calls = stack.enter_context(sample.Workers(posteriors, where, limit=limit, reject=reject))
        stored = StoredRun(directory, spec, posterior.data.values, factors, plan.quick, resumes)
        stored.expect_same(posterior, limit)
        if stored.has_ended(sampler):
            return stored
        stored.take(plan.reuse if not resumes else None)
        again = resume_command(directory or Path(), options)
        stack.enter_context(_explained(calls, lambda: stored.left(again)))
        display = _display(plan)
        target = sample.PosteriorTarget(
            spec.priors, posterior.data, spec.seed, calls, stored.storage, plan.deadlines, display,
            posterior.comparison if sampler.emulates else None,
            factors=sample.factor_targets(factors, spec.seed, calls, stored.storage.factors, plan.deadlines, display),
        )  # fmt: skip
        for weighted in sample.run_sampler(sampler, target):
            stored.keep(weighted, target.asked, late=target.time_left() < 0)
        stored.finish(sampler, late=target.time_left() < 0)
    return stored


def _display(plan: _Plan) -> sample.SamplingProgress:
    """Return the display of the progress; for a chain it shows the mass inside the largest radius of the data."""
    spec, radius = plan.spec, measured_radius(plan.spec)

    def mass(theta: Array) -> float:
        return float(Host(spec.host(theta)).mass_inside(np.array([radius]))[0])

    full_cost = _particles(spec) / _particles(cheap_spec(spec))
    return sample.SamplingProgress(plan.progress, plan.deadlines.sampling, (radius, mass), full_cost)


def _particles(spec: Spec) -> int:
    """Return the particles of all streams together; 1 without a stream."""
    return sum(stream.stripping.centre.particles for stream in spec.sections.streams.values()) or 1


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
