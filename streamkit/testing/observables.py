"""Checks of an observable: a stream with everything, and streams without."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from streamkit import HostData, Observable, Prediction, Stream
from streamkit.testing.common import Check, require
from streamkit.testing.speed import observable_is_fast
from streamkit.testing.streams import PARTICLES, example_stream, select


def _predict(observable: Observable, stream: Stream) -> Prediction:
    """Predict from a copy; a warning is as bad as an error, since a run would print it thousands of times."""
    stream = select(stream, slice(None))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return observable.predict(stream)


def _poor_streams() -> dict[str, Stream]:
    """Streams that lack what an observable may look for."""
    stream = example_stream()
    everything = np.ones(len(stream), dtype=bool)
    still = np.zeros(50, dtype=int)
    return {
        "no particles": select(stream, ~everything),
        "one particle": select(stream, [0]),
        "seven particles": select(stream, np.arange(0, len(stream), len(stream) // 7)[:7]),
        "bound particles only": replace(stream, bound=everything, t_strip=np.zeros(len(stream))),
        "a leading arm only": select(stream, stream.arm > 0),
        "a trailing arm only": select(stream, stream.arm < 0),
        "particles all in one place": select(stream, still),
        "particles released today": select(stream, stream.t_release > -0.1),
        "a progenitor without a next apocentre": replace(stream, ahead=lambda: None),
    }


def has_a_fixed_length(observable: Observable) -> None:
    """Check that names, mean, variance and data have one length, whatever the stream."""
    full = _predict(observable, example_stream())
    m = len(full.names)
    values, errors = observable.data()
    shapes = [full.mean.shape, full.variance.shape, values.shape, errors.shape]
    require(shapes == [(m,)] * 4, f"{m} names, but mean, variance and data have shapes {shapes}")
    require(not (errors <= 0).any(), f"data() gives standard errors that are not positive: {errors}")
    for what, stream in _poor_streams().items():
        poor = _predict(observable, stream)
        require(poor.names == full.names, f"names {full.names} become {poor.names} for a stream with {what}")
        require(
            poor.mean.shape == poor.variance.shape == (m,),
            f"mean and variance have shapes {poor.mean.shape}, {poor.variance.shape} given {what}",
        )


def measures_a_stream(observable: Observable) -> None:
    """Check that a stream of 4000 particles with two arms has a value and a variance, zero or more."""
    full = _predict(observable, example_stream())
    require(not full.why_not, f"says {full.why_not!r} of a stream with two long arms")
    require(np.isfinite(full.mean).all(), f"the mean is {full.mean} and why_not is empty")
    require((full.variance >= 0).all(), f"the variance is {full.variance}")


def does_not_care_for_the_order(observable: Observable) -> None:
    """Check that shuffled particles give the same to rounding, and the same stream exactly the same."""
    stream = example_stream()
    first, second = _predict(observable, stream), _predict(observable, stream)
    require(np.array_equal(first.mean, second.mean), f"two calls give {first.mean} and {second.mean}")
    shuffled = _predict(observable, select(stream, np.random.default_rng(0).permutation(len(stream))))
    same = np.allclose(shuffled.mean, first.mean, rtol=1e-8) and np.allclose(
        shuffled.variance, first.variance, rtol=1e-6
    )
    require(same, f"shuffled particles give {shuffled.mean} instead of {first.mean}")


def leaves_the_stream_alone(observable: Observable) -> None:
    """Check that ``predict`` does not write into the stream."""
    stream = select(example_stream(), slice(None))
    observable.predict(stream)
    changed = [n for n in PARTICLES if not np.array_equal(getattr(example_stream(), n), getattr(stream, n))]
    require(not changed, f"predict changes {', '.join(changed)}")


SEEDS = 12  # number of streams of 2000 particles for the scatter of a measurement


def variance_is_that_of_the_scatter(observable: Observable) -> None:
    """Check the variance against the scatter over streams with other draws: between a tenth and thirty times."""
    all_of_them = [_predict(observable, example_stream(2000, seed)) for seed in range(3, 3 + SEEDS)]
    some = [one for one in all_of_them if not one.why_not]
    if len(some) < 4:
        return
    scatter = np.var([one.mean for one in some], axis=0, ddof=1)
    variances = np.median([one.variance for one in some], axis=0)
    for name, true, said in zip(some[0].names, scatter, variances, strict=True):
        require(
            0.1 * true <= said <= 30 * true or said == true == 0,
            f"{name}: the variance is {said:.3g}, and the scatter over {len(some)} streams {true:.3g}: return the "
            "variance of the mean that comes from the number of particles, sum(w^2 (x - mean)^2) for weights of sum 1",
        )


def says_why_not(observable: Observable) -> None:
    """Check that a stream without the feature gives NaN and a short constant reason, and no exception."""
    for what, stream in _poor_streams().items():
        try:
            poor = _predict(observable, stream)
        except Exception as error:  # whatever it raises, the author needs to know for which stream
            message = f"raises {type(error).__name__} for a stream with {what}: {error}"
            raise AssertionError(message) from error
        nan = bool(np.isnan(poor.mean).any())
        require(nan == bool(poor.why_not), f"mean {poor.mean} with why_not {poor.why_not!r} given {what}")
        require(
            not any(c.isdigit() for c in poor.why_not),
            f"the reason {poor.why_not!r} holds a number: runs count their rejections by the reason",
        )
        require(nan or (poor.variance >= 0).all(), f"variance {poor.variance} for a stream with {what}")


def has_a_covariance_of_its_data(observable: Observable | HostData) -> None:
    """Check that a covariance, if there is one, has the data's errors on its diagonal and is positive definite."""
    covariance = observable.covariance()
    if covariance is None:
        return
    values, errors = observable.data()
    m, used = len(values), np.isfinite(values)
    require(np.shape(covariance) == (m, m), f"the covariance has the shape {np.shape(covariance)} for {m} data")
    some = np.asarray(covariance)[np.ix_(used, used)]
    require(np.allclose(some, some.T, rtol=1e-6), "the covariance is not symmetric")
    require(
        np.allclose(np.sqrt(np.diag(some)), errors[used], rtol=1e-6),
        f"data() gives the errors {errors[used]}, and the diagonal of the covariance {np.sqrt(np.diag(some))}",
    )
    require(np.linalg.eigvalsh(some).min() > 0, "the covariance is not positive definite")


def gives_each_datum_one_quantity(observable: Observable | HostData) -> None:
    """Check that the rows of ``quantities()`` are those of the data, each once."""
    rows = [int(row) for part in observable.quantities().values() for row in part]
    m = len(observable.data()[0])
    require(sorted(rows) == list(range(m)), f"quantities() gives the rows {sorted(rows)} for {m} data: each once")


def has_a_likelihood(observable: Observable) -> None:
    """Check that an ``ln_likelihood`` of its own is one finite number, and the same again; None is a Gaussian."""
    full = _predict(observable, example_stream())
    for add_noise in (False, True):
        first, second = (observable.ln_likelihood(full, add_noise) for _ in range(2))
        require(first == second, f"two calls of ln_likelihood give {first} and {second}")
        require(first is None or (np.ndim(first) == 0 and np.isfinite(first)), f"ln_likelihood gives {first}")
        residuals, m = observable.residuals(full, add_noise), len(full.names)
        shape = (m,) if residuals is None else np.shape(residuals)
        require(shape == (m,), f"residuals have the shape {shape} for {m} data")
    scatter, used = observable.scatter(full), np.isfinite(observable.data()[0])
    require(np.shape(scatter) == (m,), f"scatter has the shape {np.shape(scatter)} for {m} data")
    require(bool((scatter[used] > 0).all()), f"scatter is not positive: {scatter[used]}")


CHECKS: tuple[Check, ...] = (
    has_a_fixed_length,
    measures_a_stream,
    does_not_care_for_the_order,
    leaves_the_stream_alone,
    variance_is_that_of_the_scatter,
    says_why_not,
    has_a_covariance_of_its_data,
    gives_each_datum_one_quantity,
    has_a_likelihood,
    observable_is_fast,
)
