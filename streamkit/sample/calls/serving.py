"""The other side of `Workers`: what a worker process, or a worker of a given executor, does."""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Mapping
from typing import Protocol

from streamkit.errors import PluginError, StreamkitError
from streamkit.sample.calls.processes import Processes
from streamkit.sample.calls.threads import one_thread
from streamkit.sample.calls.timeout import call_with_timeout
from streamkit.sample.evaluation import Evaluation
from streamkit.stream import Array

MANY, PER_PROCESSOR = 64, 4  # workers that are allowed everywhere, and for each processor
Answers = list[Evaluation | str]  # an evaluation for each point, or `timeout.NO_ANSWER`


class Evaluates(Protocol):
    """The part of `Posterior` that `Workers` needs; tests write small classes with it."""

    def evaluate(self, theta: Array) -> Evaluation:
        """Evaluate at theta (d,)."""

    def rejected(self, reason: str) -> Evaluation:
        """Return the evaluation of parameters without an answer."""


def pool(count: int, posteriors: Mapping[str, Evaluates] | None = None, limit: float = math.inf) -> Processes:
    """Return worker processes that hold the posteriors; a call may take ``limit`` seconds.

    Raises StreamkitError for far more than this machine has processors.
    """
    processors = os.cpu_count() or 1
    if count > (most := max(MANY, PER_PROCESSOR * processors)):
        raise StreamkitError(
            f"workers: found {count}, expected at most {most} on this machine, which has {processors} "
            f"processor{'s' * (processors != 1)}: more of them take memory and time"
        )
    return Processes(count, _set_posteriors, (dict(posteriors or {}),), limit)


_POSTERIORS: dict[str, Evaluates] = {}  # the posteriors of this worker process, set once by its initializer
# The posteriors that were last sent to a worker of a given executor, by their pickle.
_SENT: dict[bytes, dict[str, Evaluates]] = {}


def _set_posteriors(posteriors: Mapping[str, Evaluates]) -> None:
    _POSTERIORS.update(posteriors)


def evaluate_held(which: str, points: Array) -> Answers:
    """Evaluate one of the posteriors that this worker process holds at points (n, d)."""
    return [_POSTERIORS[which].evaluate(point) for point in points]


def evaluate_sent(sent: bytes, which: str, points: Array, limit: float = math.inf) -> Answers:
    """Evaluate one of the posteriors that were ``sent`` as a pickle at points (n, d): for a given executor."""
    new = sent not in _SENT
    if new:
        _SENT.clear()
        try:
            _SENT[sent] = pickle.loads(sent)  # noqa: S301  our own
        except (AttributeError, ImportError) as error:
            raise PluginError(
                f"a worker cannot find what the run needs ({error}). A class given in Python must be in a module that "
                "every worker can import; or put it in a file and name that under plugins in the run file."
            ) from error
    limits = [math.inf if new and i == 0 else limit for i in range(len(points))]  # the first call may compile
    with one_thread():
        evaluate = _SENT[sent][which].evaluate
        return [call_with_timeout(most, evaluate, point) for most, point in zip(limits, points, strict=True)]
