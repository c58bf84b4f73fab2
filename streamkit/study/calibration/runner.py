"""The calibration: many draws, each appended to a file when it is finished."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from streamkit.errors import StreamkitError
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.calibration.draw import Draw, make_draw
from streamkit.study.grid import run_jobs

DRAWS = "draws.jsonl"  # the finished draws, one in a line, below the digest of their run file


@dataclass(frozen=True)
class Calibration:
    """The finished draws of a run file, in order. ``stopped`` is the reason of missing draws; empty without any.

    ``truth`` is the run file whose streams gave the data, if it differs.
    """

    spec: Spec
    draws: tuple[Draw, ...]
    stopped: str = ""
    truth: Spec | None = None

    @cached_property
    def ranks(self) -> Array:
        """(n, d + 3) The fraction of the posterior samples below each true parameter, then below each enclosed mass."""
        return np.array([(*draw.ranks, *draw.mass_ranks) for draw in self.draws])

    def coverage(self, probability: float) -> Array:
        """(d + 3,) The share of the draws whose truth lies in the central interval of this probability.

        Of the parameters, then of the enclosed masses.
        """
        return np.asarray((np.abs(self.ranks - 0.5) <= 0.5 * probability).mean(axis=0))


def calibrate(
    spec: Spec,
    out: Path,
    draws: int,
    workers: int = 1,
    resume: bool = False,
    done: Callable[[], object] = lambda: None,
    truth: Spec | None = None,
) -> Calibration:
    """Make as many draws as are missing, each a fit of its own; ``done`` is called after each.

    The data come from the streams of ``truth``, where that is given (see `make_draw`).

    Raises StreamkitError if ``out`` holds draws of another run file, or some without ``resume``, or if
    the free parameters of ``truth`` are not those of the fit. Raises ComponentError if a component fails.
    """
    if truth is not None and (truth.names, truth.priors) != (spec.names, spec.priors):
        raise StreamkitError(f"{spec.source}: {_difference(spec, truth)}")
    file = out / DRAWS
    earlier = read_draws(file, spec, truth) if resume else {}
    if not resume or not file.exists():
        out.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({"digest": _digest(spec, truth)}) + "\n", encoding="utf-8")
    packed = pickle.dumps((spec, truth))
    for _ in earlier:
        done()
    jobs = {index: (packed, index, file) for index in range(draws) if index not in earlier}
    new, stopped = run_jobs(_work, jobs, workers, done)
    every = {**earlier, **new}
    if not every:
        raise StreamkitError(f"{spec.source}: {stopped} before the first draw was finished")
    return Calibration(spec, tuple(every[index] for index in sorted(every)), stopped, truth)


def read_draws(file: Path, spec: Spec, truth: Spec | None = None) -> dict[int, Draw]:
    """Return the draws in a file by number; incomplete lines, which a kill may leave, are skipped."""
    if not file.exists():
        return {}
    first, *lines = file.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    if json.dumps(_digest(spec, truth)) not in first:
        raise StreamkitError(f"{file}: these draws belong to another run file, or to other settings of it")
    draws = {}
    for line in lines:
        try:
            draw = Draw.of_line(line)
        except ValueError:
            continue
        if len(draw.ranks) == len(spec.names):
            draws[draw.index] = draw
    return draws


def _digest(spec: Spec, truth: Spec | None) -> str:
    return spec.digest() if truth is None else f"{spec.digest()} {truth.digest()}"


def _difference(spec: Spec, truth: Spec) -> str:
    """Name a free parameter that only one of them has, or that has different priors."""
    priors, others = (dict(zip(each.names, each.priors, strict=True)) for each in (spec, truth))
    name = next(name for name in (*priors, *others) if priors.get(name) != others.get(name))
    what = "none" if name not in others else "another prior" if name in priors else "one"
    return (
        f"the streams of the truth must have the free parameters of the fit: for {name} they have {what}. Give both "
        "the same number, with --set or in the run file"
    )


def _work(job: tuple[bytes, int, Path]) -> Draw:
    packed, index, file = job
    spec, truth = pickle.loads(packed)  # noqa: S301  our own, from the process that started this one
    draw = make_draw(spec, index, truth)
    line = f"\n{draw.line()}\n".encode()  # one write; the newline in front ends a line that a kill has cut
    handle = os.open(file, os.O_WRONLY | os.O_APPEND)
    try:
        os.write(handle, line)
    finally:
        os.close(handle)
    return draw
