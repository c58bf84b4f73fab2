"""The options of a run: their changes of the sampler and the engine, and their form on a command line."""

from __future__ import annotations

from concurrent.futures import Executor
from numbers import Integral
from pathlib import Path

from streamkit.components import ChainSampler, Sampler
from streamkit.errors import SpecError
from streamkit.runfile import Engine, Spec

QUICK_PARTICLES = 2000


def quick_spec(spec: Spec) -> Spec:
    """Return the spec of the coarse look: fewer particles and walkers, the noise of the former added."""
    settings = {f"sampler.{name}": value for name, value in spec.sampler.quick_settings(len(spec.names)).items()}
    return spec.with_particles(QUICK_PARTICLES).with_values({**settings, "likelihood.noise": "add"})


def cheap_spec(spec: Spec) -> Spec:
    """Return the spec that searches for a start: few particles, their noise added to the data's."""
    return spec.with_particles(spec.sampler.search_size()[1]).with_values({"likelihood.noise": "add"})


def sampler_of(spec: Spec, steps: int | None) -> Sampler:
    """Return the sampler with the given largest length of its chain; SpecError if it makes none."""
    sampler = spec.sampler
    if steps is None:
        return sampler
    if not isinstance(sampler, ChainSampler):
        raise SpecError(f"steps: the sampler {sampler.kind!r} has no steps. Fields of [sampler] decide when it ends.")
    if isinstance(steps, bool) or not isinstance(steps, Integral) or steps < 1:
        raise SpecError(f"steps: found {steps!r}, expected a whole number, 1 or more")
    return sampler.model_copy(update={"steps": int(steps)})


def engine_of(spec: Spec, workers: int | Executor | None, kind: str | None, scheduler: str | None) -> Engine:
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


def arguments_of(
    spec: Spec, chosen: Engine, steps: int | None, quick: bool, literature: str | Path | None, pdf: bool
) -> list[str]:
    """Return the arguments of the command that a resumed run needs too."""
    shown = [*(["--literature", str(literature)] if literature is not None else []), *(["--pdf"] if pdf else [])]
    words = {"--engine": "kind", "--scheduler": "scheduler", "--workers": "workers"}
    changed = [(word, str(getattr(chosen, name))) for word, name in words.items()
               if getattr(chosen, name) not in (getattr(spec.engine, name), "")]  # fmt: skip
    most = ["--steps", str(steps)] if steps is not None else []
    return [*(["--quick"] if quick else []), *(part for pair in changed for part in pair), *most, *shown]
