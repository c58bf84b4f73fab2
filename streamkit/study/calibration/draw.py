"""One draw of a calibration: a truth from the prior, mock data of it, their fit, and the ranks of the truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import TypeAdapter

from streamkit.components import FINE
from streamkit.errors import blamed
from streamkit.fit import Results, run
from streamkit.model import Host
from streamkit.runfile import Spec
from streamkit.stream import Array
from streamkit.study.calibration.compared import MASS_RADII, of_host, shares_below, true_parameters
from streamkit.study.calibration.method import Method, as_samples, name_of
from streamkit.study.calibration.mocks import draw_mock

FINEST = 1000  # samples of another method whose hosts are computed
OURS = 5000  # and of our own fits


@dataclass(frozen=True)
class Draw:
    """The result of one draw."""

    index: int  # the number of the draw; with the run file's seed it determines the random numbers
    # (d,) the parameters, in the units of the run file, and the fraction of the posterior samples below each; None for
    # those that the truth lacks.
    truth: tuple[float | None, ...]
    ranks: tuple[float | None, ...]
    # (k,) the same for the quantities of the host, see `of_host`; a rank is None where the fit's do not vary.
    host: tuple[float, ...]
    host_ranks: tuple[float | None, ...]
    # the largest R-hat, NaN for weighted samples, and the smallest effective number of samples, of the fit.
    r_hat: float
    ess: float
    calls: int  # number of computed streams; 0 for another method
    converged: bool  # whether the rule of its sampler was met; another method has none
    said: tuple[tuple[str, str], ...] = ()  # subject and level of each check of the fit's page that is not "fine"

    def line(self) -> str:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_line(line: str) -> Draw:
        """Read a result of the method `line`; ValueError for any other text."""
        return TypeAdapter(Draw).validate_json(line)


def make_draw(
    spec: Spec, index: int, truth: Spec | None = None, method: Method | None = None, radii: Sequence[float] = MASS_RADII
) -> Draw:
    """Draw a truth from the prior, make data of it with other random numbers than the fit's, and fit them.

    Talts+ 2018, arXiv:1804.06788. A truth without a measurable stream is drawn again: its posterior is empty too.

    ``truth`` is another run file, from whose priors the truth is drawn and whose streams give the data: this tests a
    fit by a model that is not the true one. A ``method`` gives the samples in place of the fit. ``radii`` in kpc are
    those of the masses that are compared.

    Raises StreamkitError if none of a thousand truths has a stream, the observable makes no mock data, or the method's
    samples cannot be used; ComponentError if the method fails.
    """
    truth = spec if truth is None else truth
    theta, mock = draw_mock(spec, truth, index)
    if method is None:
        return rank_truth(run(mock.spec, engine="serial", progress=False), index, theta, truth, radii)
    name = f"the method {name_of(method)}"
    with blamed(name):
        given = method(mock)
    samples = as_samples(given, spec, f"draw {index}: {name}")
    return rank_samples(samples, spec, index, theta, truth, radii)


def rank_truth(results: Results, index: int, theta: Array, truth: Spec, radii: Sequence[float] = MASS_RADII) -> Draw:
    """Return the rank of the truth among the samples of a finished fit.

    The truth is the run file whose host is the true one at its parameters ``theta``.
    """
    quality = (
        float(np.max(results.r_hat)),
        float(np.nan_to_num(results.ess).min()),
        results.calls + results.search_calls,
        not results.draws.lacks,
        tuple((each.subject, each.level) for each in results.verdicts if each.level != FINE),
    )
    return _ranked(results.samples, results.some(OURS), results.spec, index, theta, truth, radii, quality)


def rank_samples(
    samples: Array, spec: Spec, index: int, theta: Array, truth: Spec, radii: Sequence[float] = MASS_RADII
) -> Draw:
    """Return the rank of the truth among samples (n, d) of another method, as `rank_truth` for our own."""
    n = len(samples)
    some = samples[np.linspace(0, n - 1, min(n, FINEST)).astype(int)]
    return _ranked(samples, some, spec, index, theta, truth, radii, (np.nan, float(n), 0, True, ()))


def _ranked(
    samples: Array,
    some: Array,
    spec: Spec,
    index: int,
    theta: Array,
    truth: Spec,
    radii: Sequence[float],
    quality: tuple[float, float, int, bool, tuple[tuple[str, str], ...]],
) -> Draw:
    """Return the rank; the quantities of the host are those of ``some`` samples."""
    distinct, where = np.unique(some, axis=0, return_inverse=True)
    hosts = np.array([of_host(Host(spec.host(each)), radii) for each in distinct])[where.ravel()]
    true, host = true_parameters(spec, truth, theta), of_host(Host(truth.host(theta)), radii)
    return Draw(
        index,
        tuple(x if np.isfinite(x) else None for x in true.tolist()),
        shares_below(samples, true),
        tuple(host.tolist()),
        shares_below(hosts, host),
        *quality,
    )
