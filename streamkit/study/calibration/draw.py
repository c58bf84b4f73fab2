"""One draw of a calibration: a truth from the prior, mock data of it, their fit, and the ranks of the truth."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import TypeAdapter

from streamkit.errors import blamed
from streamkit.fit import Results, run
from streamkit.model import Host
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.calibration.method import Method, as_samples, name_of
from streamkit.study.calibration.mocks import draw_mock

MASS_RADII = (50.0, 100.0, 200.0)  # radii in kpc of the enclosed masses that are compared besides the parameters
FINEST = 1000  # samples of another method whose hosts are computed


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
    calls: int  # number of computed streams; 0 for another method
    converged: bool  # whether the rule of its sampler was met; another method has none

    def line(self) -> str:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_line(line: str) -> Draw:
        """Read a result of the method `line`; ValueError for any other text."""
        return TypeAdapter(Draw).validate_json(line)


def make_draw(spec: Spec, index: int, truth: Spec | None = None, method: Method | None = None) -> Draw:
    """Draw a truth from the prior, make data of it with other random numbers than the fit's, and fit them.

    Talts+ 2018, arXiv:1804.06788. A truth without a measurable stream is drawn again: its posterior is empty too.

    ``truth`` is another run file with the same free parameters, whose stream gives the data: this tests a fit by a
    model that is not the true one. A ``method`` gives the samples in place of the fit.

    Raises StreamkitError if none of a thousand truths has a stream, the observable makes no mock data, or the method's
    samples cannot be used; ComponentError if the method fails.
    """
    truth = spec if truth is None else truth
    theta, mock = draw_mock(spec, truth, index)
    if method is None:
        return rank_truth(run(mock.spec, engine="serial", progress=False), index, theta, truth)
    name = f"the method {name_of(method)}"
    with blamed(name):
        given = method(mock)
    return rank_samples(as_samples(given, spec, f"draw {index}: {name}"), spec, index, theta, truth)


def rank_truth(results: Results, index: int, theta: Array, truth: Spec) -> Draw:
    """Return the rank of the truth among the samples of a finished fit.

    The truth is the run file whose host is the true one at ``theta`` (d,).
    """
    radii = np.array(MASS_RADII)
    return _ranked(
        results.samples,
        results.profiles(radii)[0],
        index,
        theta,
        truth,
        (
            float(np.max(results.r_hat)),
            float(np.nan_to_num(results.ess).min()),
            results.calls + results.search_calls,
            not results.draws.lacks,
        ),
    )


def rank_samples(samples: Array, spec: Spec, index: int, theta: Array, truth: Spec) -> Draw:
    """Return the rank of the truth among samples (n, d) of another method, as `rank_truth` for our own."""
    radii, n = np.array(MASS_RADII), len(samples)
    some = samples[np.linspace(0, n - 1, min(n, FINEST)).astype(int)]
    masses = np.array([Host(spec.host(each)).mass_inside(radii) for each in some])
    return _ranked(samples, masses, index, theta, truth, (np.nan, float(n), 0, True))


def _ranked(
    samples: Array, fitted: Array, index: int, theta: Array, truth: Spec, quality: tuple[float, float, int, bool]
) -> Draw:
    masses = Host(truth.host(theta)).mass_inside(np.array(MASS_RADII))
    return Draw(
        index,
        tuple(theta.tolist()),
        tuple((samples < theta).mean(axis=0).tolist()),
        tuple(masses.tolist()),
        tuple((fitted < masses).mean(axis=0).tolist()),
        *quality,
    )
