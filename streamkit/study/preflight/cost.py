"""The cost of a run: the first call of a process, a later one, and the search for a start."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from streamkit.errors import SpecError
from streamkit.model import Model
from streamkit.runfile import Spec
from streamkit.sample import Posterior, expected_calls, first_call
from streamkit.stream import Array
from streamkit.study.preflight.draws import TRIAL_PARTICLES, PriorDraws, observe

SLOW = 5.0  # CPU seconds above which a first call is not repeated: loading machine code is a small part of it


@dataclass(frozen=True)
class Cost:
    """CPU seconds of the first call of a process and of a later one, measured at ``where``, and of the search."""

    first: float
    call: float
    where: str
    # streams that the search for a start will make, about; 0 where nothing can be fitted or was tried.
    search_calls: int = 0
    search: float = 0.0  # CPU seconds of them, about


def search_cost(spec: Spec, tried: PriorDraws | None, call: float) -> tuple[int, float]:
    """Estimate the streams of the search for a start and their CPU seconds, from trial streams over the prior."""
    if tried is None or not tried.draws:
        return 0, 0.0
    points, particles = spec.sampler.search_size()
    if not points:
        return 0, 0.0
    cheap, full = expected_calls(points, len(spec.names), len(tried.good) / tried.draws)
    each = tried.total / tried.draws * min(1.0, particles / TRIAL_PARTICLES)
    return cheap + full, cheap * each + full * call


def time_call(spec: Spec, theta: Array, first: float) -> tuple[float, str]:
    """Return the CPU seconds of a call at theta (d,): the median of a few, or ``first`` if that was `SLOW`.

    The call is one of the posterior, or of the stream alone where nothing can be fitted; the second value is
    then the reason why.
    """
    unfit = ""
    call: Callable[[Array], object] = partial(observe, Model(spec))
    try:
        call = Posterior(spec)
    except SpecError as error:
        unfit = str(error)
    if first > SLOW:
        return first, unfit
    first_call(spec.sampler.call_limit, call, theta)  # draws the random numbers of a new process
    seconds: list[float] = []
    while len(seconds) < 3 and sum(seconds) < 3.0:
        begin = time.process_time()
        call(theta)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds)), unfit
