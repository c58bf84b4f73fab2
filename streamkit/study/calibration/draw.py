"""One draw of a calibration: a truth from the prior, mock data of it, their fit, and the ranks of the truth."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from streamkit.errors import OutOfDomain, StreamkitError
from streamkit.fit import Results, run
from streamkit.model import Host
from streamkit.observe import parts_of
from streamkit.runfile import Spec
from streamkit.sample import Posterior
from streamkit.stream import Array

MASS_RADII = (50.0, 100.0, 200.0)  # radii in kpc of the enclosed masses that are compared besides the parameters
TRIES = 1000  # largest number of draws for a truth with a measurable stream


@dataclass(frozen=True)
class Draw:
    """The result of one draw."""

    index: int  # the number of the draw; with the run file's seed it determines the random numbers
    # (d,) the parameters, in the units of the run file, and the fraction of the posterior samples below each.
    truth: tuple[float, ...]
    ranks: tuple[float, ...]
    # the same for the enclosed mass in Msun at `MASS_RADII`.
    masses: tuple[float, ...]
    mass_ranks: tuple[float, ...]
    # the largest R-hat, NaN for weighted samples, and the smallest effective number of samples, of the fit.
    r_hat: float
    ess: float
    calls: int  # number of computed streams
    converged: bool  # whether the rule of its sampler was met

    def line(self) -> str:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_line(line: str) -> Draw:
        """Read a result of the method `line`; ValueError for any other text."""
        return TypeAdapter(Draw).validate_json(line)


def make_draw(spec: Spec, index: int, truth: Spec | None = None) -> Draw:
    """Draw a truth from the prior, make data of it with other random numbers than the fit's, and fit them.

    Talts+ 2018, arXiv:1804.06788. A truth without a measurable stream is drawn again: its posterior is empty too.

    ``truth`` is another run file with the same free parameters, whose stream gives the data: this tests a fit by a
    model that is not the true one.

    Raises StreamkitError if none of a thousand truths has a stream, or the observable makes no mock data.
    """
    truth = spec if truth is None else truth
    rng = np.random.default_rng([spec.seed, 7, index])
    theta, mocked = _mock(spec, truth, rng, index)
    return rank_truth(run(mocked, engine="serial", progress=False), index, theta, truth)


def rank_truth(results: Results, index: int, theta: Array, truth: Spec) -> Draw:
    """Return the rank of the truth among the samples of a finished fit.

    The truth is the run file whose host is the true one at ``theta`` (d,).
    """
    samples, radii = results.samples, np.array(MASS_RADII)
    masses = Host(truth.host(theta)).mass_inside(radii)
    fitted = results.profiles(radii)[0]
    return Draw(
        index,
        tuple(theta.tolist()),
        tuple((samples < theta).mean(axis=0).tolist()),
        tuple(masses.tolist()),
        tuple((fitted < masses).mean(axis=0).tolist()),
        float(np.max(results.r_hat)),
        float(np.nan_to_num(results.ess).min()),
        results.calls + results.search_calls,
        not results.draws.lacks,
    )


def _mock(spec: Spec, truth: Spec, rng: np.random.Generator, index: int) -> tuple[Array, Spec]:
    """Return a truth, and the run file of the fit with mock data of it."""
    posterior = Posterior(truth.with_values({"seed": int(rng.integers(1 << 31))}))
    for _ in range(TRIES):
        theta = np.array([float(prior.sample(rng, 1)[0]) for prior in spec.priors])
        try:
            observation = posterior.observe(theta)
        except OutOfDomain:
            continue
        if any(prediction.why_not for prediction in observation.predictions.values()):
            continue
        fields: dict[str, Any] = {}
        for stream, inputs in truth.bind_all(theta).streams.items():
            sections, parts = truth.sections.streams[stream].observables, parts_of(observation.predictions[stream])
            for name, observable in inputs.observables.items():
                mock = observable.mock(parts[name], rng)
                fields |= {f"{sections[name].path}.{field}": value for field, value in mock.items()}
        return theta, spec.with_values(fields)
    raise StreamkitError(f"draw {index}: none of {TRIES} points of the prior has a stream that can be measured")
