"""The calibration: many draws, each appended to a file when it is finished."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from streamkit.errors import StreamkitError, brief
from streamkit.report import UnwritableError, save
from streamkit.runfile import Source, Spec, as_spec
from streamkit.stream import Array, BoolArray, IntArray
from streamkit.study.calibration.compared import MASS_RADII, check_truth, quantities
from streamkit.study.calibration.draw import Draw, make_draw, rank_samples
from streamkit.study.calibration.method import Method, name_of, read_samples
from streamkit.study.calibration.mocks import read_truths
from streamkit.study.grid import ended_before, run_jobs

DRAWS = "draws.jsonl"  # the finished draws, one in a line, below the digest of their run file


@dataclass(frozen=True)
class Calibration:
    """The finished draws of a run file, in order. ``stopped`` is the reason of missing draws; empty without any.

    ``truth`` is the run file whose streams gave the data, if it differs. ``method`` names another method that gave the
    samples; empty for our own fits. ``radii`` in kpc are those of the enclosed masses.
    """

    spec: Spec
    draws: tuple[Draw, ...]
    stopped: str = ""
    truth: Spec | None = None
    method: str = ""
    radii: tuple[float, ...] = MASS_RADII

    @cached_property
    def compared(self) -> IntArray:
        """(c,) The numbers of the parameters, then of the quantities of the host, that every draw has a rank of."""
        return np.flatnonzero(np.isfinite(self._every).all(axis=0))

    @cached_property
    def _every(self) -> Array:
        return np.array([(*draw.ranks, *draw.host_ranks) for draw in self.draws], dtype=float)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what is compared: free parameters of the fit, then enclosed masses, velocity and flattening."""
        every = (*self.spec.names, *quantities(self.radii))
        return tuple(every[i] for i in self.compared)

    @cached_property
    def ranks(self) -> Array:
        """(n, c) The fraction of the posterior samples below the true value of each of `names`."""
        return self._every[:, self.compared]

    @property
    def truths(self) -> Array:
        """(n, c) The true values of `names`, parameters in the units of the run file, masses in Msun, km/s."""
        return np.array([(*draw.truth, *draw.host) for draw in self.draws], dtype=float)[:, self.compared]

    def coverage(self, probability: float) -> Array:
        """(c,) The share of the draws whose truth lies in the central interval of this probability, of `names`."""
        return np.asarray((np.abs(self.ranks - 0.5) <= 0.5 * probability).mean(axis=0))

    @cached_property
    def missed(self) -> BoolArray:
        """(n,) Whether a true value lies outside its interval, which together hold all in 95 % of draws or more."""
        level = 1 - 0.05 / max(self.ranks.shape[1], 1)  # Bonferroni
        return np.asarray((np.abs(self.ranks - 0.5) > 0.5 * level).any(axis=1))

    @cached_property
    def beyond_priors(self) -> dict[str, int]:
        """The number of draws whose true value is outside the fit's prior, of each parameter that has such draws."""
        true = np.array([draw.truth for draw in self.draws], dtype=float)
        ends = np.array([prior.support for prior in self.spec.priors]).reshape(-1, 2)
        beyond = ((true < ends[:, 0]) | (true > ends[:, 1])).sum(axis=0).tolist()
        return {name: count for name, count in zip(self.spec.names, beyond, strict=True) if count}


def calibrate(
    run_file: Source,
    out: str | Path,
    draws: int,
    workers: int = 1,
    resume: bool = False,
    done: Callable[[], object] = lambda: None,
    truth: Spec | None = None,
    method: Method | None = None,
    radii: Sequence[float] = MASS_RADII,
) -> Calibration:
    """Make as many draws as are missing, each a fit of its own.

    Parameters
    ----------
    run_file
        A spec, the path of a run file, or a mapping of the same form.
    out
        A directory: each finished draw is added to a file there.
    draws
        Their number.
    workers
        Processes that fit.
    resume
        Whether finished draws in ``out`` are kept.
    done
        Called after each draw.
    truth
        Another run file with the same streams: it gives truths, from its own priors, and their data. Its host may be of
        another family, and its schemes may be others. Compared are the parameters of the fit that it has too, and the
        hosts.
    method
        Another method, whose posterior takes the place of our fit: a function of a `Mock` that returns samples (n, d)
        in the order of ``spec.names``, or a mapping of arrays (n,) by name, in the units of the run file.
    radii
        Radii in kpc of the enclosed masses that are compared, beside v_c at 8 kpc and the flattening of the potential
        at 20 kpc.

    Raises StreamkitError if ``out`` holds draws of another run file, or some without ``resume``, if ``truth`` lacks
    data of the fit, or if the samples of the method cannot be used. Raises ComponentError if a component or the method
    fails.
    """
    spec, out, radii = as_spec(run_file), Path(out), tuple(radii)
    if truth is not None:
        check_truth(spec, truth)
    name = "" if method is None else name_of(method)
    if method is not None and workers > 1:
        _check_portable(method, name)
    file = out / DRAWS
    earlier = read_draws(file, spec, truth, name, radii) if resume else {}
    if not resume or not file.exists():
        _begin(file, _digest(spec, truth, name, radii))
    packed = pickle.dumps((spec, truth))
    for _ in earlier:
        done()
    jobs = {index: (packed, method, radii, index, file) for index in range(draws) if index not in earlier}
    try:
        new, stopped = run_jobs(_work, jobs, workers, done)
    except StreamkitError:
        if not read_draws(file, spec, truth, name, radii):
            file.unlink()  # without a draw there is nothing to continue
        raise
    every = {**earlier, **new}
    if not every:
        raise ended_before(spec.source, stopped, "the first draw was finished")
    return Calibration(spec, tuple(every[index] for index in sorted(every)), stopped, truth, name, radii)


def calibrate_samples(
    spec: Spec,
    directory: Path,
    out: Path,
    draws: int | None = None,
    done: Callable[[], object] = lambda: None,
    truth: Spec | None = None,
    radii: Sequence[float] = MASS_RADII,
) -> Calibration:
    """Rank the truths among the samples of another method, in the directory that `write_mocks` made.

    `read_samples` describes their files. ``draws`` is the number of draws, all of the mock data by default.

    Raises StreamkitError if there are no mock data, those of another run file, or fewer than ``draws``; if a draw has
    no samples, or they cannot be used.
    """
    truths = read_truths(directory, spec, truth)
    if draws is not None and draws > len(truths):
        raise StreamkitError(f"{directory}: has mock data of {len(truths)} draws; {draws} are wanted")
    made, name, radii = [], f"files in {directory.name}", tuple(radii)
    for index in sorted(truths)[:draws]:
        samples = read_samples(directory, index, spec)
        made.append(rank_samples(samples, spec, index, truths[index], spec if truth is None else truth, radii))
        done()
    _begin(out / DRAWS, _digest(spec, truth, name, radii), made)
    return Calibration(spec, tuple(made), "", truth, name, radii)


def _begin(file: Path, digest: str, draws: Sequence[Draw] = ()) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps({"digest": digest}), *(draw.line() for draw in draws)]
    save(file, lambda part: part.write_text("\n".join(lines) + "\n", encoding="utf-8"))


def _check_portable(method: Method, name: str) -> None:
    """Raise StreamkitError if a method cannot be sent to another process."""
    try:
        pickle.dumps(method)
    except Exception as error:  # pickle raises what it meets
        raise StreamkitError(
            f"the method {name} cannot be sent to other processes ({brief(error)}): define it at the top of a module, "
            "or use one worker"
        ) from None


def read_draws(
    file: Path, spec: Spec, truth: Spec | None = None, method: str = "", radii: Sequence[float] = MASS_RADII
) -> dict[int, Draw]:
    """Return the draws in a file by number; incomplete lines, which a kill may leave, are skipped."""
    if not file.exists():
        return {}
    first, *lines = file.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    if json.dumps(_digest(spec, truth, method, radii)) not in first:
        raise StreamkitError(
            f"{file}: these draws belong to another run file, to other settings of it, or to another method"
        )
    draws = {}
    for line in lines:
        try:
            draw = Draw.of_line(line)
        except ValueError:
            continue
        if len(draw.ranks) == len(spec.names):
            draws[draw.index] = draw
    return draws


def _digest(spec: Spec, truth: Spec | None, method: str, radii: Sequence[float]) -> str:
    """Return what draws depend on: the run files of fit and truth, what is compared, and a method that is not ours."""
    parts = [each.digest() for each in (spec, truth) if each is not None]
    return " ".join([*parts, *quantities(radii), *([method] if method else [])])


def _work(job: tuple[bytes, Method | None, tuple[float, ...], int, Path]) -> Draw:
    packed, method, radii, index, file = job
    spec, truth = pickle.loads(packed)  # noqa: S301  our own, from the process that started this one
    draw = make_draw(spec, index, truth, method, radii)
    line = f"\n{draw.line()}\n".encode()  # one write; the newline in front ends a line that a kill has cut
    handle = os.open(file, os.O_WRONLY | os.O_APPEND)
    try:
        os.write(handle, line)
    except OSError as error:
        raise UnwritableError(f"{file}: draw {index} cannot be written ({error.strerror})") from None
    finally:
        os.close(handle)
    return draw
